"""What perception is confident of is tried; the rest is refused with a reason."""

from types import SimpleNamespace

import numpy as np
import pytest

from fungrasp.errors import FungraspError
from fungrasp.grasps import HumanGraspSet, builtin_grasps, load_objects
from fungrasp.jobs import PartStore
from fungrasp.synthetic_captures import perceived_grasps as room
from fungrasp.synthetic_captures.perceived_grasps import grasps_from_images


def test_images_are_numbered_and_doubtful_ones_refused(monkeypatch, tmp_path) -> None:
    human = builtin_grasps().select([0, 1])
    answers = iter(range(4))

    def perceive(capture, model, **options):
        number = next(answers)
        if number == 1:
            raise FungraspError("no hand was found in the image")
        grasp = human[number // 2]
        grasps = HumanGraspSet.of([grasp])
        warnings = ("the depth is noisy",)
        return SimpleNamespace(grasp=grasp, grasps=grasps, confident=number != 2, warnings=warnings)

    monkeypatch.setattr(room, "render_capture", lambda *args: SimpleNamespace(capture=None))
    monkeypatch.setattr(room, "MediaPipeHandDetector", lambda: None)
    monkeypatch.setattr(room, "perceive", perceive)
    store = PartStore(tmp_path / "seen")
    seen = grasps_from_images(human, load_objects(human), 2, 0, store)
    assert seen.index == [0, 3]
    assert len(seen.human) == 2
    assert seen.refused == {1: "no hand was found in the image", 2: "low confidence: the depth is noisy"}
    # What is kept is not looked at again: there are no more answers.
    again = grasps_from_images(human, load_objects(human), 2, 0, store, rows=[4, 9])
    assert (again.index, list(again.refused)) == ([8, 19], [9, 18])
    np.testing.assert_array_equal(again.human.hand_joints, seen.human.hand_joints)


def test_nothing_is_seen(monkeypatch) -> None:
    human = builtin_grasps().select([0])

    def perceive(capture, model, **options):
        raise FungraspError("no hand was found in the image")

    monkeypatch.setattr(room, "render_capture", lambda *args: SimpleNamespace(capture=None))
    monkeypatch.setattr(room, "MediaPipeHandDetector", lambda: None)
    monkeypatch.setattr(room, "perceive", perceive)
    with pytest.raises(FungraspError, match="confident of no image"):
        grasps_from_images(human, load_objects(human), 1, 0)
