"""Changes that the server offers: corrections of findings, and other forms of values."""
