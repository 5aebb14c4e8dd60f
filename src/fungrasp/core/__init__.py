"""What every other folder builds on: errors, files, records, long work, file formats, provenance."""

__version__ = "0.1.0"
