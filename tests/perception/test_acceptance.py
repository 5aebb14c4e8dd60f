"""One record: the probabilities, the numbers that they rest on, and what would help."""

import dataclasses

import numpy as np
import pytest

from fungrasp.perception import HandEstimate, ObjectEstimate
from fungrasp.perception.acceptance import (
    ACCEPT,
    ACCEPTED_HAND,
    Acceptance,
    Logistic,
    judge,
    object_probability,
)
from fungrasp.perception.io.estimates import PoseEvidence

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


def judged(evidence: PoseEvidence, score: float = 0.9, joints_sure: float = 0.9) -> Acceptance:
    probability = object_probability(evidence)
    obj = ObjectEstimate(
        np.array([0, 0, 0.5, 1.0, 0, 0, 0]), probability, probability >= ACCEPT, evidence=evidence
    )
    return judge(obj, hand(score, joints_sure))


def test_good_evidence_is_sure_and_needs_no_help():
    said = judged(GOOD)
    assert said.sure and not said.help
    assert said.object >= ACCEPT and said.hand >= ACCEPTED_HAND
    assert said.probability == said.object * said.hand
    assert said.summary().startswith("sure: ")


@pytest.mark.parametrize(
    ("changes", "help"),
    [
        ({"other_size": 0.3, "other_side": 0.1}, "a mesh of the right size"),
        ({"other_size": 0.05, "other_side": 0.08}, "another view"),
        ({"explained": 0.3}, "the mesh of this very object"),
        ({"visible": 0.4}, "the mesh of this very object"),
        ({"larger": 6.0}, "the mesh of this very object"),
        ({"larger": -6.0}, "the mesh of this very object"),
        ({"off": 9.0}, "the mesh of this very object"),
        ({"mask_piece": 2000.0}, "the mesh of this very object"),
        ({"left_over": 0.4}, "the mesh of this very object"),
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
    assert not said.sure and said.object < judged(GOOD).object
    assert help in "; ".join(said.help)


def test_an_outline_that_is_not_seen_says_little_and_is_called_not_known():
    said = judged(dataclasses.replace(GOOD, larger=np.nan, off=np.nan))
    rows = {one.name: one for one in said.evidence}
    assert all(np.isnan(rows[name].value) and abs(rows[name].share) < 1.5 for name in ("larger", "off"))
    assert [row[1] for row in said.rows() if "outline" in row[0]] == ["not known"] * 2
    assert [entry["value"] for entry in said.as_json()["evidence"] if "outline" in entry["name"]] == []
    assert said.as_json()["evidence"][1]["value"] is None


def test_pieces_of_a_mask_are_not_known_without_one():
    for hinted, words in ((0.0, "not known"), (0.5, "not known"), (1.0, "0 pixels")):
        said = judged(dataclasses.replace(GOOD, hinted=hinted))
        assert [row[1] for row in said.rows() if "mask beyond" in row[0]] == [words]
        share = next(one.share for one in said.evidence if one.name == "mask_piece")
        assert share == next(one.share for one in judged(GOOD).evidence if one.name == "mask_piece")


def test_where_a_pose_was_given_a_mask_helps_but_not_a_click():
    obj = ObjectEstimate(
        np.array([0, 0, 0.5, 1.0, 0, 0, 0]), 0.2, False, evidence=dataclasses.replace(GOOD, hinted=0.0)
    )
    found, given = (judge(obj, hand(), given=said).help for said in (False, True))
    assert any("click" in words for words in found)
    assert "a mask of the object (--mask)" in given and not any("click" in words for words in given)


def test_joints_that_are_not_sure_make_the_hand_unsure():
    said = judged(GOOD, joints_sure=0.2)
    assert not said.sure and said.hand < ACCEPTED_HAND < said.object
    assert said.help == ("a view in which more of the hand is seen, bare and well lit",)


def test_terminal_and_json_have_the_same_numbers():
    said = judged(dataclasses.replace(GOOD, edge_width=8.0, explained=0.7))
    head, *rows = said.rows()
    record = said.as_json()
    assert head == ("evidence", "value", "usual", "for or against") and len(rows) == len(record["evidence"])
    for row, entry in zip(rows, record["evidence"], strict=True):
        assert row[1].startswith(f"{entry['value']:.3g}") and row[3] == f"{entry['share']:+.1f}"
    assert record["sure"] == said.sure and record["probability"] == said.probability
    agreement = next(entry for entry in record["evidence"] if entry["name"] == "agreement")
    # Outlines four times as wide as sharp ones: what does not agree counts less.
    assert agreement["value"] == pytest.approx(100 * (1 - 0.3 ** (4**0.25)))


def test_shares_add_up_to_the_odds():
    weights = Logistic(0.5, {"a": (2.0, 0.1), "b": (-1.0, 0.2)})
    shares = weights.shares({"a": 0.3, "b": 0.5})
    assert shares == pytest.approx({"a": 0.4, "b": -0.3})
    assert weights.probability({"a": 0.3, "b": 0.5}) == pytest.approx(1 / (1 + np.exp(-0.6)))


def test_a_fitted_shape_is_said_to_be_one():
    obj = ObjectEstimate(np.array([0, 0, 0.5, 1.0, 0, 0, 0]), 0.7, True)
    said = judge(obj, hand(), fitted="box:60x28x30")
    assert said.sure and said.summary().startswith("unknown object: a box of 60 x 28 x 30 mm explains 70 %")
    assert said.as_json()["fitted"] == "box:60x28x30"


def test_a_doubt_is_more_than_any_probability():
    obj = ObjectEstimate(np.array([0, 0, 0.5, 1.0, 0, 0, 0]), 0.99, True)
    said = judge(obj, hand(), doubt="it looks like the other hand")
    assert not said.sure and said.object == 0.99 and said.hand >= ACCEPTED_HAND
    assert said.summary().startswith("not sure: it looks like the other hand (object 99 %")
    assert said.as_json()["doubt"] == said.doubt and judge(obj, hand()).as_json()["doubt"] is None
    shape = judge(obj, hand(), fitted="box:60x28x30", doubt="another size")
    assert not shape.sure and shape.summary().endswith("; not sure: another size")
