"""How good and how fast perception is."""
