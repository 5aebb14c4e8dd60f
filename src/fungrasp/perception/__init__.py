"""From one RGB-D image of a person holding an object to a human grasp."""

from fungrasp.perception.estimates import HandEstimate, ObjectEstimate
from fungrasp.perception.io.capture import Capture, Intrinsics

__all__ = ["Capture", "HandEstimate", "Intrinsics", "ObjectEstimate"]
