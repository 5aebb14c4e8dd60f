"""Where objects and their tables are, in worlds that differ from what is believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fungrasp.geometry.poses import invert, quaternion_from_rotation_vector, rotate
from fungrasp.objects import ObjectModel
from fungrasp.transfer import EpisodeSample, offset_pose, tilt_on_table


@dataclass(frozen=True, eq=False)
class Placement:
    """Objects at rest on their tables, I of them."""

    object_pose: np.ndarray
    """World frame, shape [I, 7]."""
    table_height: np.ndarray
    """Height of the table top under the object [m], shape [I]."""
    table_tilt: np.ndarray
    """Rotation vector of the table top, world frame x and y [rad], shape [I, 2]."""

    @property
    def height_at_origin(self) -> np.ndarray:
        """Height of the table top at the world's origin [m], shape [I]."""
        zero = np.zeros((len(self.table_tilt), 1))
        turn = quaternion_from_rotation_vector(np.concatenate([self.table_tilt, zero], axis=1))
        normal = rotate(turn, np.array([0.0, 0.0, 1.0]))
        slope = np.sum(normal[:, :2] * self.object_pose[:, :2], axis=1) / normal[:, 2]
        return self.table_height + slope


def on_drawn_table(pose: np.ndarray, height: np.ndarray, sample: EpisodeSample) -> Placement:
    """Objects whose tables are higher and tilted, as drawn.

    Args:
        pose: on the nominal tables, world frame, shape [I, 7].
        height: of the nominal tables [m], shape [I].
        sample: what was drawn, I rows.
    """
    raised, table = pose.copy(), height + sample.table_height
    raised[:, 2] += sample.table_height
    if sample.table_tilt.any():
        raised = tilt_on_table(raised, sample.table_tilt, table)
    return Placement(raised, table, sample.table_tilt)


def where_seen(
    seen: np.ndarray,
    height: np.ndarray,
    sample: EpisodeSample,
    models: Sequence[ObjectModel],
    center: np.ndarray,
) -> Placement:
    """Objects that are seen where a plan has them: where they are, as their estimated poses are off.

    The table is known by the object that stands on it: where that is seen too high, so is the table. The
    lowest point stays as far from the table as it was; an object that leans after its turn falls into place.

    Args:
        seen: poses with the sample's error, world frame, shape [I, 7].
        height: of the tables that they are seen on [m], shape [I].
        sample: what was drawn, I rows.
        models: of the objects, length I.
        center: of mass [m], object frame, about which the rotation is off, shape [I, 3].
    """
    if not sample.object_bias.any():
        return on_drawn_table(seen, height, sample)
    pose = offset_pose(seen, -sample.object_bias, center)
    too_high = sample.object_bias[:, 2]
    pose[:, 2] = seen[:, 2] + _lowest(models, seen) - _lowest(models, pose) - too_high
    return on_drawn_table(pose, height - too_high, sample)


def _lowest(models: Sequence[ObjectModel], pose: np.ndarray) -> np.ndarray:
    """Height of the objects' lowest points above their origins [m], shape [I]."""
    up = rotate(invert(pose)[:, 3:], np.array([0.0, 0.0, 1.0]))
    return np.array([np.min(model.vertices @ u) for model, u in zip(models, up, strict=True)])
