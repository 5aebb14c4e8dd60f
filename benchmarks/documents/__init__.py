"""Tables and pictures of README and docs."""
