"""A word on another pose of the object that fits almost as well as the answer."""

from __future__ import annotations

import numpy as np
import trimesh

from fungrasp.geometry.poses import transform_points
from fungrasp.objects import ObjectModel
from fungrasp.perception.estimates import ObjectEstimate
from fungrasp.perception.hand.object_contact import Surroundings
from fungrasp.perception.object_pose.confidence import RIVAL_DISTANCE
from fungrasp.perception.object_pose.pose_error import rotation_error

TURNED = 30.0
"""A pose turned by more than this [degrees] is another one, however well it fits."""

CLOSE = 0.1
"""Poses whose score is lower by less than this fit almost as well."""

SAME = 0.001
"""Poses whose surfaces are nearer than this on average [m] look the same: a symmetry."""

POINTS = 300
"""Of the object's surface, by which poses are compared."""


def other_pose(model: ObjectModel, thing: ObjectEstimate) -> str:
    """What speaks for another pose than the answer, in words; empty if nothing does.

    The score is that of the surface's place. Of a nearly symmetric object it may be certain although it is
    not which way round the object is.
    """
    near = [pose for pose, score in thing.alternatives if score > thing.score - CLOSE]
    if not near:
        return ""
    points = np.asarray(trimesh.sample.sample_surface(model.mesh, POINTS, seed=0)[0])
    answer = Surroundings(model.signed_distance, thing.pose_camera_object)
    apart = np.array(
        [np.abs(answer.object_distance(transform_points(pose, points))[0]).mean() for pose in near]
    )
    turned = np.degrees(rotation_error(np.stack(near), thing.pose_camera_object))
    others = np.flatnonzero(((turned > TURNED) & (apart > SAME)) | (apart > RIVAL_DISTANCE))
    if not len(others):
        return ""
    # They come in the order of their scores.
    first = others[0]
    if apart[first] > RIVAL_DISTANCE:
        what = f"turned by {turned[first]:.0f} degrees" if turned[first] > TURNED else "elsewhere"
        return f"where the object is: {what}, {1000 * apart[first]:.0f} mm away, it fits almost as well"
    return (
        f"which way round the object is: turned by {turned[first]:.0f} degrees it fits almost as well, with "
        f"its surface only {1000 * apart[first]:.0f} mm elsewhere on average"
    )
