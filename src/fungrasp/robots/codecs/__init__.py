"""Translates between radians and newton metres and the bytes on the wires: pure functions."""
