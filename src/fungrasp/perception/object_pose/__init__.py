"""Pose estimation of a known mesh in a depth image."""
