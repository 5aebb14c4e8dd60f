"""Where a fixed camera stands in the world of the cell: from a board on the hand; and whether
base and mount are as the cell says, from touched points."""
