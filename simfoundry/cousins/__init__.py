"""Digital cousins: recipes that generate variants of a scene and place, settle and check each one."""
