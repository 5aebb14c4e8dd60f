"""Points of a hand's flesh on the lines between its joints, where it is compared with what is around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.perception.hand.skeleton import PALM_RADIUS, RADII, WRIST_RADIUS


@dataclass(frozen=True, eq=False)
class Probes:
    """Points between pairs of joints."""

    near: np.ndarray
    """Joint at one end, shape [P]."""
    far: np.ndarray
    """Joint at the other end, shape [P]."""
    part: np.ndarray
    """Where between them, 0 to 1, shape [P]."""
    radius: np.ndarray
    """Flesh around the line there, for a hand of mean size [m], shape [P]."""

    def place(self, joints: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points [m], shape [P, 3], and their derivatives, [P, 3, n]."""
        a = self.part[:, None]
        points = (1 - a) * joints[self.near] + a * joints[self.far]
        a = a[..., None]
        return points, (1 - a) * jacobian[self.near] + a * jacobian[self.far]


def _probes() -> Probes:
    rows = [(0, 0, 0.0, WRIST_RADIUS)]
    for finger in range(5):
        base = 1 + 4 * finger
        if finger < 4:
            rows += [(0, base, part, PALM_RADIUS) for part in (0.35, 0.65, 0.9)]
        for link in range(3):
            first, last = RADII[finger, link], RADII[finger, link + 1]
            # The tip joint is on the skin: the last link's flesh ends before it.
            parts = (0.05, 0.35, 0.65, 0.8) if link == 2 else (0.05, 0.35, 0.65, 0.95)
            rows += [(base + link, base + link + 1, x, first + x * (last - first)) for x in parts]
    near, far, part, radius = zip(*rows, strict=True)
    return Probes(np.array(near), np.array(far), np.array(part), np.array(radius))


PROBES = _probes()
"""One at the wrist, three along each bone of the palm, four along each link of the fingers."""

FINGERTIP_PROBES = [np.flatnonzero(PROBES.near == 3 + 4 * finger) for finger in range(5)]
"""Those on each finger's last link."""


def in_front(points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Which points of the flesh are not hidden behind others, bool, shape [P].

    Args:
        points: [m], shape [P, 3], camera frame.
        radius: of the flesh around them [m], shape [P].
    """
    slopes = points[:, :2] / points[:, 2:]
    aside = np.linalg.norm(slopes[:, None] - slopes, axis=-1) * points[:, 2]
    skin = points[:, 2] - radius
    return ~((aside < 0.9 * radius) & (skin < skin[:, None] - 0.5 * radius[:, None])).any(axis=1)
