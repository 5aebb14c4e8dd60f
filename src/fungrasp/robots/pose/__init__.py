"""Sources of object poses."""
