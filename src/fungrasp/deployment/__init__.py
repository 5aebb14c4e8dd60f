"""Deployment: the 10 Hz loop, its supervisor, the safety filter, the log."""
