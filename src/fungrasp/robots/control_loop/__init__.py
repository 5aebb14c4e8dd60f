"""Runs a device at its own rate in a process or thread of its own, and makes a driver of it."""
