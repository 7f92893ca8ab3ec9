"""Object cousins: variants of one object by rules, from a library or by models, each checked."""
