"""From one RGB-D image of a person holding an object to a human grasp."""

from fungrasp.perception.capture import Capture, Intrinsics
from fungrasp.perception.estimates import HandEstimate, ObjectEstimate

__all__ = ["Capture", "HandEstimate", "Intrinsics", "ObjectEstimate"]
