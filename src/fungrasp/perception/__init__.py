"""Human grasps from RGB-D images of a person who holds an object."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fungrasp.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fungrasp.perception.io.capture import Capture, Intrinsics
    from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate
    from fungrasp.perception.perceived import Perceived
    from fungrasp.perception.pipeline import perceive

__all__ = ["Capture", "HandEstimate", "Intrinsics", "ObjectEstimate", "Perceived", "perceive"]

__getattr__ = lazy_names(
    __name__,
    {
        "io.capture": "Capture Intrinsics",
        "io.estimates": "HandEstimate ObjectEstimate",
        "perceived": "Perceived",
        "pipeline": "perceive",
    },
)
