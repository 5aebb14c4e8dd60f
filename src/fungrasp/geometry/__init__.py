"""Poses, batched rigid transforms and signed distances of meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fungrasp.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fungrasp.geometry.signed_distance import SignedDistanceBank, SignedDistanceGrid

__all__ = ["SignedDistanceBank", "SignedDistanceGrid"]

__getattr__ = lazy_names(__name__, {"signed_distance": " ".join(__all__)})
