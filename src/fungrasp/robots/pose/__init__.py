"""Sources of the object's pose."""
