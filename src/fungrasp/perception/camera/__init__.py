"""Depth cameras that give frames one after the other, and whether a frame will do."""
