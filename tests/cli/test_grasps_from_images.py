"""What perception is confident of is tried; the rest is refused with a reason."""

from types import SimpleNamespace

import fungrasp.perception.hand.mediapipe_detector as detection
import fungrasp.perception.pipeline as pipeline
import fungrasp.synthetic_captures.render_capture as rendering
from fungrasp.cli.grasps_from_images import grasps_from_images
from fungrasp.errors import FungraspError
from fungrasp.grasps import HumanGraspSet, builtin_grasps, load_objects


def test_images_are_numbered_and_doubtful_ones_refused(monkeypatch) -> None:
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

    monkeypatch.setattr(rendering, "render_capture", lambda *args: SimpleNamespace(capture=None))
    monkeypatch.setattr(detection, "MediaPipeHandDetector", lambda: None)
    monkeypatch.setattr(pipeline, "perceive", perceive)
    seen = grasps_from_images(human, load_objects(human), 2, 0)
    assert seen.index == [0, 3]
    assert seen.human is not None and len(seen.human) == 2
    assert seen.refused == {1: "no hand was found in the image", 2: "low confidence: the depth is noisy"}
