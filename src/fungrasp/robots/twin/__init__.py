"""Twins: simulated robot cells with hidden true parameters."""
