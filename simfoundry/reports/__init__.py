"""HTML pages: the templates, the common style, and the data of each page."""
