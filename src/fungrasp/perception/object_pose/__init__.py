"""The pose of a known mesh in a depth image."""
