"""Where a fixed camera stands in the world of the cell: from a board on the hand, or from touched points."""
