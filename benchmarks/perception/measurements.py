"""What the measurements of perception share: when a pose is right, what ``perceive`` makes of an image, times
and rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation.statistics import wilson_interval
from fungrasp.objects import ResolvedObject
from fungrasp.perception import Capture
from fungrasp.perception.hand.detected_hand import HandDetector
from fungrasp.perception.perceived import Perceived, StageSeconds
from fungrasp.perception.pipeline import perceive

RIGHT_MM = 10.0
"""An object's pose is right if its ADD-S is below this."""


def perceived(capture: Capture, obj: ResolvedObject, detector: HandDetector) -> Perceived | None:
    """What ``perceive`` makes of an image; None where it finds no hand.

    Args:
        capture: the image, with what is said of the object's place.
        obj: the object.
        detector: finds hands.
    """
    try:
        return perceive(capture, obj, detector=detector)
    except FungraspError:
        return None


def together(seconds: Mapping[str, StageSeconds], *stages: str) -> StageSeconds:
    """The time of some stages; all if none is named."""
    chosen = [seconds[stage] for stage in stages or seconds if stage in seconds]
    return StageSeconds(sum(one.wall for one in chosen), sum(one.cpu for one in chosen))


def rate_of(flags: Sequence[bool]) -> dict[str, Any] | None:
    """Share of the flags that are set, its count and interval; None where there is nothing to count."""
    if not flags:
        return None
    count = sum(flags)
    return {
        "count": len(flags),
        "rate": count / len(flags),
        "interval": wilson_interval(count, len(flags)),
    }
