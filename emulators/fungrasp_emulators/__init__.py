"""Devices that speak the wire protocols, for tests and for trying everything without a robot."""
