"""Recorded episodes in another physics engine."""
