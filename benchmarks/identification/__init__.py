"""Identified dynamics against known ones."""
