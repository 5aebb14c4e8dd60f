"""Several looks at one grasp: what they say together."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from fungrasp.errors import FungraspError
from fungrasp.geometry.poses import compose, quaternion_from_rotation_vector, transform_points
from fungrasp.grasps import builtin_grasps
from fungrasp.objects import builtin_object
from fungrasp.perception.object_pose.confidence import ACCEPT
from fungrasp.perception.several_looks import best_of_looks, together
from fungrasp.perception.verdict import PerceptionVerdict

MUG = builtin_object("mug")
JOINTS = builtin_grasps()[0].hand_joints
HELD = np.array([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Look:
    """The part of a ``Perceived`` that counts here."""

    verdict: PerceptionVerdict
    hand: SimpleNamespace
    object: SimpleNamespace
    object_model = MUG

    @property
    def confident(self) -> bool:
        return self.verdict.sure


def look(probability: float, turn: float = 0.0, shift: float = 0.0, hand: float = 0.9) -> Look:
    """A look from a camera turned by an angle [rad]; the object is seen so far from its place [m]."""
    camera = np.concatenate([[0.02, 0.1, 0.6], quaternion_from_rotation_vector(np.array([0.3, turn, 0.1]))])
    pose = compose(camera, HELD + np.concatenate([[shift], np.zeros(6)]))
    return Look(
        PerceptionVerdict(probability >= ACCEPT, probability, hand, (), ()),
        SimpleNamespace(joints_camera=transform_points(camera, JOINTS)),
        SimpleNamespace(pose_camera_object=pose),
    )


def test_looks_that_agree_are_surer_together_however_the_camera_moved():
    both = together([look(0.95), look(0.96, turn=1.0)])
    assert both.verdict.object > ACCEPT and both.verdict.sure and both.verdict.looks == 2
    best = look(0.96, turn=1.0).object.pose_camera_object
    assert both.object.pose_camera_object.tobytes() == best.tobytes()
    assert "2 looks" in both.verdict.words
    three = together([look(0.95), look(0.96, turn=1.0), look(0.955, turn=-0.5)])
    assert both.verdict.object < three.verdict.object < 0.995, "they err alike, so three are not much surer"


def test_a_look_that_says_no_or_sees_it_elsewhere_counts_against():
    assert together([look(0.92), look(0.1, turn=1.0)]).verdict.object < 0.7
    elsewhere = together([look(0.92), look(0.9, turn=1.0, shift=0.09)])
    assert elsewhere.verdict.object < 0.8 and not elsewhere.verdict.sure


def images(*probabilities: float) -> list[SimpleNamespace]:
    """Captures that differ where what is said of them does."""
    return [SimpleNamespace(said=p, color=np.full((2, 2, 3), p)) for p in probabilities]


def test_no_further_look_where_one_is_sure():
    seen = []

    def perceived(capture):
        seen.append(capture.said)
        return look(capture.said)

    assert best_of_looks(images(0.98, 0.2), perceived, 2).verdict.looks == 1 and seen == [0.98]
    seen.clear()
    assert best_of_looks(images(0.8, 0.85, 0.1), perceived, 2).verdict.object == pytest.approx(0.87, abs=0.02)
    assert seen == [0.8, 0.85], "no more than two were wanted"
    assert best_of_looks(images(0.6), perceived, 5).verdict == look(0.6).verdict
    weak = [replace(look(0.98), verdict=replace(look(0.98).verdict, hand=0.2, sure=False)) for _ in range(2)]
    assert not together(weak).verdict.sure, "the hand is not"


def test_an_image_that_was_looked_at_already_says_nothing_new():
    said = best_of_looks(images(0.9, 0.9, 0.9), lambda capture: look(capture.said), 3).verdict
    assert said == look(0.9).verdict and said.looks == 1


def test_a_later_image_without_a_hand_does_not_take_the_first_answer_away():
    def perceived(capture):
        if capture.said == 0.5:
            raise FungraspError("no hand found")
        return look(capture.said)

    assert best_of_looks(images(0.8, 0.5, 0.85), perceived, 3).verdict.looks == 2
    with pytest.raises(FungraspError, match="no hand"):
        best_of_looks(images(0.5, 0.8), perceived, 3)
