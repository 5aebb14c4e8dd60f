"""This package's retargeting beside that of others."""
