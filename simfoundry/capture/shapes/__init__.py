"""From the seen points of one object to a closed, textured solid that stands on its support."""
