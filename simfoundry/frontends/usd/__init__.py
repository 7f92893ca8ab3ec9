"""USD in: any stage as a new document, and stages compiled from a document back into it (``compiled``)."""
