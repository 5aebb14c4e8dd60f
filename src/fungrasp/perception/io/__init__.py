"""Captures from files, folders and cameras."""
