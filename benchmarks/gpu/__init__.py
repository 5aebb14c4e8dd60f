"""Thousands of worlds on a GPU: how fast, in how much memory."""
