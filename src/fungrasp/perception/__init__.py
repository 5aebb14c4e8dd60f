"""From one RGB-D image of a person holding an object to a human grasp.

The names are imported on use: the options of a command (``image_source``) need none of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fungrasp.perception.io.capture import Capture, Intrinsics
    from fungrasp.perception.io.estimates import HandEstimate, ObjectEstimate
    from fungrasp.perception.perceived import Perceived
    from fungrasp.perception.pipeline import perceive

__all__ = ["Capture", "HandEstimate", "Intrinsics", "ObjectEstimate", "Perceived", "perceive"]

_MODULES = {
    "Capture": "io.capture",
    "HandEstimate": "io.estimates",
    "Intrinsics": "io.capture",
    "ObjectEstimate": "io.estimates",
    "Perceived": "perceived",
    "perceive": "pipeline",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'fungrasp.perception' has no attribute '{name}'")
    return getattr(import_module(f"fungrasp.perception.{_MODULES[name]}"), name)
