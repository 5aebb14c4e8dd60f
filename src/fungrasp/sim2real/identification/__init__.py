"""Identification of a hand's joint dynamics from a log of commands and positions (paper section IV.C.2)."""
