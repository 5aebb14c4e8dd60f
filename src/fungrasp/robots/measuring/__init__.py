"""Measures drivers against emulated devices: reactions to faults, load, latency."""
