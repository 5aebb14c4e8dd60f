"""Drivers that run the control loop of a device in a separate process, at the device's own rate."""
