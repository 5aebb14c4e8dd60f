"""Detection of the hand, and fit of a metric skeleton to image and object."""
