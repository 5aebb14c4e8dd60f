"""What the measurements of a hand are worth, whether or not the object that it holds is known."""

from __future__ import annotations

from dataclasses import dataclass, field

from fungrasp.perception.hand.object_contact import ContactSettings


@dataclass(frozen=True)
class SeenSettings:
    """What landmarks, depth, background and the landmark model's shape are worth."""

    landmark_spread: float = 0.03
    """Standard deviation of a landmark, as a part of the hand's extent in the image."""
    least_landmark_spread: float = 2.0
    """[pixels]"""
    depth_spread: float = 0.012
    """Standard deviation of depth at a point of the flesh [m]: camera, thickness, and that neighbours err
    alike."""
    object_depth: float = 0.004
    """What is seen so near to the known object's surface [m] is the object."""
    background: float = 0.02
    """What is seen farther behind a part of the hand [m] is background to it."""
    background_levels: int = 3
    """How many depths of the hand's parts are told apart for that."""
    silhouette_spread: float = 3.0
    """Standard deviation of the silhouette [pixels]."""
    silhouette_outlier: float = 20.0
    """A part farther in the background [pixels] is likelier hidden by a hole in the depth."""
    silhouette_inset: float = 0.7
    """Part of the flesh's thickness that is surely inside the silhouette."""
    shape_spread: float = 0.35
    """Standard deviation of the landmark model's bone directions [rad]."""
    shape_turn_spread: float = 0.25
    """Standard deviation of their turn as a whole [rad]."""
    contact: ContactSettings = field(default_factory=ContactSettings)
    """What the object and the table are worth, where they are known."""
