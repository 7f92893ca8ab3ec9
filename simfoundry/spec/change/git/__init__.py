"""Documents as git keeps them: revisions, history, and git's own diff driver."""
