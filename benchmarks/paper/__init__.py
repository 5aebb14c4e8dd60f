"""What the paper's tables compare."""
