"""Runs a device at its own rate in a process of its own, and makes a driver of it."""
