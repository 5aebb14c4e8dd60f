"""One record: the probabilities, the numbers that they rest on, and what would help."""

import dataclasses

import numpy as np
import pytest

from fungrasp.perception import HandEstimate, ObjectEstimate
from fungrasp.perception.acceptance import ACCEPT, Acceptance, doubt_of, judge, object_score
from fungrasp.perception.io.estimates import PerceptionWarning, PoseEvidence

GOOD = PoseEvidence(
    hinted=1.0,
    explained=0.96,
    visible=0.95,
    hidden=0.2,
    pixels=2000.0,
    rival=0.0,
    other_size=-0.28,
    other_side=-0.03,
    colored=0.0,
    edge_width=2.0,
    foreign=0.0,
    larger=-0.4,
    off=1.2,
    left_over=0.0,
    mask_piece=0.0,
)


def hand(score: float = 0.9, joints_sure: float = 0.9) -> HandEstimate:
    joints = np.arange(63.0).reshape(21, 3) * 0.001 + [0.0, 0.0, 0.5]
    covariance = np.tile(np.eye(3) * 1e-5, (21, 1, 1))
    return HandEstimate(joints, np.zeros((21, 2)), np.full(21, joints_sure), covariance, "right", score)


def judged(evidence: PoseEvidence, score: float = 0.9, joints_sure: float = 0.9, **held: float) -> Acceptance:
    found = object_score(evidence)
    obj = ObjectEstimate(np.array([0, 0, 0.5, 1.0, 0, 0, 0]), found, found >= ACCEPT, evidence=evidence)
    touch = {"touching": 3, "reach": 0.0} | held
    return judge(obj, hand(score, joints_sure), **touch)  # pyright: ignore[reportArgumentType]


def test_good_evidence_is_sure_and_needs_no_help():
    said = judged(GOOD)
    assert said.sure and not said.help
    assert min(said.object, said.hand) > ACCEPT
    assert said.summary() == "sure: all 12 quantities are within their limits"
    unknown = dataclasses.replace(said.evidence[0], value=float("nan"))
    said = dataclasses.replace(said, evidence=(unknown, *said.evidence[1:]))
    assert said.summary() == "sure: the 11 known of 12 quantities are within their limits"


@pytest.mark.parametrize(
    ("changes", "help"),
    [
        ({"other_size": 0.3, "other_side": 0.1}, "a mesh of the right size"),
        ({"other_size": 0.05, "other_side": 0.05}, "another view"),
        ({"explained": 0.3}, "a mesh of exactly this object"),
        ({"visible": 0.4}, "a mesh of exactly this object"),
        ({"larger": 6.0}, "a mesh of exactly this object"),
        ({"larger": -6.0}, "a mesh of exactly this object"),
        ({"off": 9.0}, "a mesh of exactly this object"),
        ({"mask_piece": 2000.0}, "a mesh of exactly this object"),
        ({"left_over": 0.4}, "a mesh of exactly this object"),
        ({"hinted": 0.0, "explained": 0.6}, "a click at the object"),
        ({"explained": 0.3, "hidden": 0.8}, "another view: 80 % of the object is behind the hand"),
        ({"explained": 0.3, "pixels": 350.0}, "the camera nearer to it: only 350 pixels show the object"),
        ({"explained": 0.3, "edge_width": 9.0}, "filters turned off"),
        ({"explained": 0.3, "foreign": 0.4}, "a tighter mask: 40 %"),
        ({"explained": 0.3, "rival": 0.98}, "a mesh with colors"),
    ],
)
def test_evidence_against_says_what_would_help(changes, help):
    said = judged(dataclasses.replace(GOOD, **changes))
    assert not said.sure and said.object < ACCEPT < judged(GOOD).object
    assert help in "; ".join(said.help)
    assert any(row[3] == "no" for row in said.rows())


@pytest.mark.parametrize(("pixels", "sure"), [(400.0, False), (2000.0, True)])
def test_what_counts_as_another_size_depends_on_the_pixels_that_show_the_object(pixels, sure):
    assert judged(dataclasses.replace(GOOD, other_size=-0.05, pixels=pixels)).sure == sure


@pytest.mark.parametrize("held", [{"touching": 0}, {"touching": 1}, {"reach": 0.025}])
def test_a_hand_that_holds_nothing_is_not_sure(held):
    said = judged(GOOD, **held)
    assert not said.sure and said.object > ACCEPT > said.hand
    assert "as measured it does not touch it" in "; ".join(said.help)


def test_a_score_is_a_half_at_the_limit_whatever_the_quantity():
    for name, value in (("off", 4.5), ("larger", -1.5), ("left_over", 0.2), ("rival", 0.97)):
        assert object_score(dataclasses.replace(GOOD, **{name: value})) == pytest.approx(0.5)


def test_an_outline_that_is_not_seen_says_nothing_and_is_called_not_known():
    said = judged(dataclasses.replace(GOOD, larger=np.nan, off=np.nan))
    assert said.sure
    assert [row[1:] for row in said.rows() if "outline" in row[0]] == [
        ("not known", "at most 1.5 pixels", "-"),
        ("not known", "at most 4.5 pixels", "-"),
    ]
    assert [one["value"] for one in said.as_json()["evidence"] if one["name"] in ("larger", "off")] == [
        None
    ] * 2


def test_pieces_of_a_mask_are_not_known_without_one():
    for hinted, words in ((0.0, "not known"), (0.5, "not known"), (1.0, "0 %")):
        said = judged(dataclasses.replace(GOOD, hinted=hinted))
        assert [row[1] for row in said.rows() if "mask beyond" in row[0]] == [words]


def test_where_a_pose_was_given_a_mask_helps_but_not_a_click():
    obj = ObjectEstimate(
        np.array([0, 0, 0.5, 1.0, 0, 0, 0]), 0.2, False, evidence=dataclasses.replace(GOOD, hinted=0.0)
    )
    found, given = (judge(obj, hand(), given=said).help for said in (False, True))
    assert any("click" in words for words in found)
    assert "a mask of the object (--mask)" in given and not any("click" in words for words in given)


def test_joints_that_are_not_sure_make_the_hand_unsure():
    said = judged(GOOD, joints_sure=0.2)
    assert not said.sure and said.hand < ACCEPT < said.object
    assert said.help == ("a view in which more of the hand is seen, bare and well lit",)
    assert "expected share of joints with an error below 20 mm 20 %, not at least 60 %" in said.summary()


def test_joints_of_a_hand_whose_object_is_not_found_need_no_other_view_of_the_hand():
    said = judged(dataclasses.replace(GOOD, explained=0.3), joints_sure=0.5)
    assert said.help and not any("hand" in words for words in said.help)


def test_what_could_not_be_compared_says_why_first():
    why = PerceptionWarning.of("not_searched", problem="the mask has only 3 pixels with depth")
    obj = ObjectEstimate(np.array([0, 0, 0.5, 1.0, 0, 0, 0]), 0.0, False, warnings=(why,))
    said = judge(obj, hand(joints_sure=0.5))
    assert said.summary() == "not sure: the mask has only 3 pixels with depth" and not said.help


def test_terminal_and_json_have_the_same_numbers():
    said = judged(dataclasses.replace(GOOD, edge_width=8.0, explained=0.6))
    head, *rows = said.rows()
    record = said.as_json()
    assert head == ("evidence", "value", "limit", "met") and len(rows) == len(record["evidence"])
    for row, entry in zip(rows, record["evidence"], strict=True):
        assert row[1].startswith(f"{entry['value']:.3g}") and row[3] == ("yes" if entry["met"] else "no")
    assert record["sure"] == said.sure and record["object"] == said.object
    assert record["evidence"][0]["value"] == pytest.approx(40.0)


def test_a_fitted_shape_is_said_to_be_one():
    obj = ObjectEstimate(np.array([0, 0, 0.5, 1.0, 0, 0, 0]), 0.7, True)
    said = judge(obj, hand(), touching=2, reach=0.0, fitted="box:60x28x30")
    assert said.sure and said.summary().startswith("unknown object: a box of 60 x 28 x 30 mm explains 70 %")
    assert said.as_json()["fitted"] == "box:60x28x30"


def test_a_doubt_is_more_than_any_quantity():
    obj = ObjectEstimate(np.array([0, 0, 0.5, 1.0, 0, 0, 0]), 0.99, True)
    said = judge(obj, hand(), doubt="it looks like the other hand")
    assert not said.sure and said.object == 0.99 and said.hand > ACCEPT
    assert said.summary() == "not sure: it looks like the other hand"
    assert said.as_json()["doubt"] == said.doubt and judge(obj, hand()).as_json()["doubt"] is None
    shape = judge(obj, hand(), fitted="box:60x28x30", doubt="another size")
    assert not shape.sure and shape.summary().endswith("not sure: another size")


def test_intrinsics_off_the_middle_and_hands_of_no_size_are_doubts():
    aside = PerceptionWarning.of("axis_off_centre", cx=200.0, cy=240.0, part=19.0)
    assert "whole image" in doubt_of([aside], None, False)
    for size, doubted in ((1.2, False), (1.63, True), (0.6, True)):
        warned = PerceptionWarning.of("hand_size", size=size, low=0.8, high=1.25)
        assert bool(doubt_of([warned], None, False)) == doubted
