"""Poses, batched rigid transforms, signed distance of a mesh. Knows nothing of hands or physics."""

from fungrasp.geometry.signed_distance import SignedDistanceBank, SignedDistanceGrid

__all__ = ["SignedDistanceBank", "SignedDistanceGrid"]
