"""Whether the image says which size a thing has."""

import numpy as np
import pytest

from fungrasp.objects import plain_shape
from fungrasp.perception.object_pose.known_object import known_object
from fungrasp.perception.object_pose.scoring import PoseScorer
from fungrasp.perception.object_pose.stretching import other_sizes

BAR = known_object(plain_shape("box:160x40x40", 0.2))
POSE = np.array([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0])


def scorer(hidden_from: float) -> PoseScorer:
    """Rays at the bar, 0.5 m away before a wall; skin in front of what is right of ``hidden_from`` [m]."""
    x, y = np.meshgrid(np.arange(-0.3, 0.3, 0.01), np.arange(-0.1, 0.1, 0.01))
    directions = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1)
    seen = BAR.rays.cast(POSE[None], directions)[0]
    skin = (0.5 * directions[:, 0] > hidden_from).astype(float)
    bar = np.where(np.isfinite(seen), 1.0 - skin, 0.0)
    depth = np.where(skin > 0, 0.42, np.where(bar > 0, seen, 0.8))
    pixels = np.argwhere(np.ones(x.shape, dtype=bool))
    spread, nothing = np.full(len(depth), 0.003), np.zeros(len(depth))
    return PoseScorer(BAR, directions, pixels, depth, spread, bar, skin, nothing, bar[None], nothing, None, 1)


def test_another_size_fits_only_where_ends_are_hidden():
    seen, hidden = (
        other_sizes(scorer(hidden_from), POSE, 0, POSE[:3], np.random.default_rng(0))
        for hidden_from in (1.0, -0.05)
    )
    assert seen.whole < -0.4 < hidden.whole
    # How thick the bar is away from the camera is never seen.
    assert seen.side == pytest.approx(0.0, abs=0.01)
