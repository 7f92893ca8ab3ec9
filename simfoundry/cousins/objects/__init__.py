"""Object cousins: variants of an object that are generated or taken from a library, and then checked."""
