"""Rendered RGB-D captures with truth, for tests, benchmarks and training of perception."""
