"""Where each name of a project is defined and used, as exact ranges of the texts."""
