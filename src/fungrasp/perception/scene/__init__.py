"""Table, world frame and segmentation of the image."""
