"""Calibration of a fixed camera from a board on the hand; check of base and mount by touched points."""
