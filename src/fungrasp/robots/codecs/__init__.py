"""Translates between radians and newton meters and the bytes on the wires: pure functions."""
