"""Drivers of robot hands."""
