"""Every HTML page: the templates, the one style, and what each page shows."""
