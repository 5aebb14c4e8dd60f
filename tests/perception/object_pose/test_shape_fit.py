"""Shapes fitted to objects without a mesh."""

from dataclasses import replace

import numpy as np
import pytest
from object_pose_scenes import scene
from scipy.spatial import KDTree

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import compose, invert, transform_points
from fungrasp.objects import plain_shape
from fungrasp.perception.object_pose.shape_fit import fit_shape
from fungrasp.perception.scene.segmentation import TIPS


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


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_shape_goes_on_behind_the_hand_that_holds_it(seed: int) -> None:
    """A stick of which the hand hides the half that it holds: thumb and fingers tell how far it goes on."""
    model, turn = plain_shape("cylinder:30x240", 0.1), np.sqrt(0.5)
    pose = np.array([-0.026, -0.08, 0.05, turn, turn, 0.0, 0.0])
    there = scene(model, pose, np.array([0.0, 0.0, 0.03]))
    world = transform_points(compose(pose, invert(there.pose)), np.nan_to_num(there.capture.points()))
    hidden = there.mask & (world[..., 1] > -0.06)
    depth, color = there.capture.depth.copy(), there.capture.color.copy()
    depth[hidden] -= 0.02
    color[there.mask], color[hidden] = [40, 60, 190], [210, 160, 130]
    capture = replace(there.capture, color=color, depth=depth, mask=there.mask & ~hidden)
    found = fit_shape(capture, there.hand.joints_camera, there.table, seed=seed)
    shape = plain_shape(found.name, 1.0)
    surface = transform_points(found.pose, np.asarray(shape.mesh.sample(2000, seed=0)))
    tips = there.hand.joints_camera[list(TIPS)]
    # The thumb's, the last one, was 60 mm and more beyond the end of what is seen.
    assert KDTree(surface).query(tips)[0].max() < 0.030
    assert 0.2 < shape.size.max() < 0.3


def test_nothing_in_the_hand_is_said() -> None:
    model = plain_shape("sphere:80", 0.1)
    there = scene(model, np.array([3.0, 0, 0.04, 1, 0, 0, 0]), np.array([0.05, 0.0, 0.06]))
    few = np.zeros_like(there.mask)
    few[:5, :5] = True
    with pytest.raises(FungraspError, match="too little of an object is seen"):
        fit_shape(there.capture.with_object(mask=few), there.hand.joints_camera, there.table)
