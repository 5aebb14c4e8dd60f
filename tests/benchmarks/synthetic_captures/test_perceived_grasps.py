"""What perception is confident of is tried; the rest is refused with a reason."""

from types import SimpleNamespace

import numpy as np

from benchmarks.synthetic_captures import perceived_grasps as module
from fungrasp.core.errors import FungraspError
from fungrasp.core.jobs import PartStore
from fungrasp.grasps import HumanGraspSet, builtin_grasps, load_objects
from fungrasp.hands import load_hand


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
        judged = SimpleNamespace(summary=lambda: "not sure: 40 %")
        return SimpleNamespace(
            grasp=grasp, grasps=grasps, confident=number != 2, warnings=warnings, acceptance=judged
        )

    monkeypatch.setattr(module, "render_capture", lambda *args: SimpleNamespace(capture=None))
    monkeypatch.setattr(module, "MediaPipeHandDetector", lambda: None)
    monkeypatch.setattr(module, "perceive", perceive)
    monkeypatch.setattr(module, "retarget", lambda human, *args, **options: human)

    def images(rows: list[int] | None = None) -> module.PerceivedGrasps:
        store, objects = PartStore(tmp_path / "seen"), load_objects(human)
        return module.PerceivedGrasps(human, objects, load_hand("allegro"), 2, 0, store, rows, threads=1)

    source = images()
    assert source.names == [n for n in human.object_name.tolist() for _ in range(2)]
    # Nothing is looked at before its turn.
    assert source.about == {"images": 0, "not_seen": {}} and next(answers) == 0
    answers = iter(range(4))
    seen = [source.take(row) for row in range(4)]
    assert [one is None for one in seen] == [False, True, True, False]
    assert source.refused == {1: "no hand was found in the image", 2: "not sure: 40 %; the depth is noisy"}
    # What is kept is not looked at again: there are no more answers.
    again = images([4, 9])
    assert again.numbers == [8, 9, 18, 19]
    np.testing.assert_array_equal(again.take(0).hand_joints, seen[0].hand_joints)
    assert again.take(2) is None
    assert again.about == {"images": 2, "not_seen": {"18": "not sure: 40 %; the depth is noisy"}}
