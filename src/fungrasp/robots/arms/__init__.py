"""Drivers of robot arms."""
