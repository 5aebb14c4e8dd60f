"""The command line: one file per command."""

INTERRUPTED = 130
"""Exit status after Ctrl-C."""
