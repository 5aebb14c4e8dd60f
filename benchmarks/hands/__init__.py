"""Hands of other makers: what ``fungrasp hands add`` makes of their descriptions, and how well they grasp."""
