"""Shapes fitted to objects without a mesh."""

from dataclasses import replace

import numpy as np
import pytest
from object_pose_scenes import scene
from scipy.spatial import KDTree

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import transform_points
from fungrasp.objects import plain_shape
from fungrasp.perception.object_pose.shape_fit import fit_shape


@pytest.mark.parametrize("name", ["box:90x60x50", "cylinder:70x90", "sphere:80"])
def test_a_shape_is_found_where_it_is(name: str) -> None:
    model = plain_shape(name, 0.1)
    pose = model.rest_pose(0.4)
    there = scene(model, pose + np.array([0, 0, 0.03, 0, 0, 0, 0]), np.array([0.045, 0.0, 0.07]))
    color = there.capture.color.copy()
    color[there.mask] = [40, 60, 190]
    capture = replace(there.capture, color=color, mask=there.mask)
    found = fit_shape(capture, there.hand.joints_camera, there.table)
    assert found.fits
    truth = transform_points(there.pose, np.asarray(model.mesh.sample(800, seed=0)))
    shape = plain_shape(found.name, 1.0)
    surface = transform_points(found.pose, np.asarray(shape.mesh.sample(800, seed=0)))
    # The far side is not seen.
    assert KDTree(surface).query(truth)[0].mean() < 0.010
    assert KDTree(truth).query(surface)[0].mean() < 0.008
    again = fit_shape(capture, there.hand.joints_camera, there.table)
    assert again.name == found.name and again.pose.tobytes() == found.pose.tobytes()


def test_nothing_in_the_hand_is_said() -> None:
    model = plain_shape("sphere:80", 0.1)
    there = scene(model, np.array([3.0, 0, 0.04, 1, 0, 0, 0]), np.array([0.05, 0.0, 0.06]))
    few = np.zeros_like(there.mask)
    few[:5, :5] = True
    with pytest.raises(FungraspError, match="too little of an object is seen"):
        fit_shape(there.capture.with_object(mask=few), there.hand.joints_camera, there.table)
