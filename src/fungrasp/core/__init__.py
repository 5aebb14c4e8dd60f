"""Foundations: errors, files, records, jobs, file formats, provenance."""

__version__ = "0.1.0"
