"""Drivers and the control computer under faults."""
