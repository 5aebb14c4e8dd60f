"""What test captures look like: cameras, hands, clutter, noise."""

from __future__ import annotations

from dataclasses import dataclass, field

from benchmarks.synthetic_captures.camera_errors import DEPTH_CAMERAS, ColorNoise, DepthCamera
from benchmarks.synthetic_captures.skin_and_sleeve import SKIN_TONES
from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.media.surfaces import Color
from fungrasp.perception import Intrinsics

TYPICAL = Intrinsics(640, 480, 615.0, 615.0, 321.5, 238.0)
"""A color camera of the kind that is sold with a depth sensor for robots."""


@dataclass(frozen=True)
class CaptureSettings:
    """What test captures look like."""

    intrinsics: Intrinsics = TYPICAL
    """Intrinsics of the typical camera; those of a capture differ by a few pixels."""
    intrinsics_spread: float = 8.0
    """Largest difference of focal length and optical axis from the typical ones [pixels]."""
    distance: tuple[float, float] = (0.4, 0.9)
    """Range of distances from the camera to the grasp [m]."""
    elevation: tuple[float, float] = (15.0, 65.0)
    """Range of elevations of the camera above the table, seen from the grasp [degrees]."""
    clutter: tuple[int, int] = (0, 5)
    """Fewest and most other objects on the table."""
    skin: tuple[Color, ...] = SKIN_TONES
    """Tones of skin, sRGB; another color makes a glove."""
    object_seen: float = 0.012
    """Part of the image that must show the object, where a camera can be found that does."""
    hand_seen: float = 0.015
    """Part of the image that must show the hand, where a camera can be found that does."""
    proportions: float = 0.0
    """Standard deviation of the size of hands, and of the lengths of their fingers, as a part; their
    fingertips stay where they are."""
    skin_like: float = 0.0
    """Part of the clutter, and of the table tops, with colors that some skin has."""
    hover: tuple[float, float] | None = None
    """Range of the gap between hand and object [m] where nothing is held; None: it is held."""
    left: float = 0.0
    """Part of the captures that are seen in a mirror: left hands, with the mirror images of objects."""
    depth_noise: tuple[DepthCamera, ...] = (DEPTH_CAMERAS["d435i"],)
    """Errors of the depth: those of one of several kinds of cameras, drawn for each capture; none for perfect
    depth."""
    color_noise: ColorNoise | None = field(default_factory=ColorNoise)
    """Noise of the color image; None for perfect color."""

    def __post_init__(self) -> None:
        for name in ("distance", "elevation", "clutter"):
            low, high = getattr(self, name)
            if not 0 <= low <= high:
                raise FungraspError(f"captures: {name} must be a range from low to high, not {low} to {high}")
        if not 0 <= self.proportions <= 0.2:
            raise FungraspError(f"captures: proportions must be from 0 to 0.2, not {self.proportions}")
        for name in ("left", "skin_like"):
            if not 0 <= getattr(self, name) <= 1:
                raise FungraspError(f"captures: {name} is a part, from 0 to 1, not {getattr(self, name)}")
        if self.distance[0] < 0.2 or self.elevation[1] > 85:
            raise FungraspError("captures: the camera must be 0.2 m away or more, and at most 85 degrees up")


def camera_settings(camera: str = "mixed", hover: tuple[float, float] | None = None) -> CaptureSettings:
    """Captures as the cameras that people have give them: melted depth, wrong exposure, hands of all sizes.

    Args:
        camera: one of ``DEPTH_CAMERAS``, or "mixed", which draws one of them for each capture.
        hover: as in ``CaptureSettings``.

    Raises:
        UnknownNameError: there is no such camera.
    """
    if camera != "mixed" and camera not in DEPTH_CAMERAS:
        raise UnknownNameError("depth camera", camera, ("mixed", *DEPTH_CAMERAS))
    cameras = tuple(DEPTH_CAMERAS.values()) if camera == "mixed" else (DEPTH_CAMERAS[camera],)
    return CaptureSettings(
        proportions=0.07,
        left=0.4,
        skin_like=0.4,
        hover=hover,
        distance=(0.45, 0.9),
        object_seen=0.006,
        depth_noise=cameras,
        color_noise=ColorNoise(
            noise=3.0, blur=0.6, balance=0.08, exposure=(0.6, 3.0), motion=4.0, jpeg=(60, 95)
        ),
    )
