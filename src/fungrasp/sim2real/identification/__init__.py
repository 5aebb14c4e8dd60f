"""Identifies the dynamics of a hand's joints from a log of commands and positions (paper section IV.C.2)."""
