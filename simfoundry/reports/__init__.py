"""HTML reports: templates, shared styles, and the data for each page."""
