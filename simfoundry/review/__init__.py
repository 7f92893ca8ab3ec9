"""Changes for people who review them: revisions of documents compared, as text and as a page with pictures."""
