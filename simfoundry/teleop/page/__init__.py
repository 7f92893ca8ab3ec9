"""The page in the browser: it shows the running world, and sends keys, drags and tracked controllers."""
