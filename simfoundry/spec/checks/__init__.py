"""What types cannot say of each kind of document: names, files, and what is plausible."""
