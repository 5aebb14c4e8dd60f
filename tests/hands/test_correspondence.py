"""Which robot link stands for which human one."""

from __future__ import annotations

import numpy as np
import pytest
from retarget_scenes import ROBOTS

from fungrasp.grasps.human_hand import HUMAN_JOINTS, HUMAN_LINKS
from fungrasp.hands import load_hand
from fungrasp.hands.correspondence import Correspondence, correspond


def matched(name: str) -> tuple[Correspondence, dict[str, int]]:
    """The correspondence, and the row of each finger link by its name."""
    hand = load_hand(name)
    return correspond(hand), {link: row for row, link in enumerate(hand.link_names[1:])}


def flags(*touching: str) -> np.ndarray:
    return np.array([[link in touching for link in HUMAN_LINKS]])


def test_the_human_hand_is_its_own_twin():
    match, _ = matched("human")
    np.testing.assert_array_equal(match.near, match.human_near)
    np.testing.assert_array_equal(match.far, match.human_far)
    assert [links for (links,) in match.human_links] == list(range(1, 16))


def test_three_links_stand_for_three():
    match, rows = matched("allegro")
    for part, near, far, link in (
        ("proximal", "mcp", "pip", "proximal"),
        ("middle", "pip", "dip", "middle"),
        ("distal", "dip", "tip", "distal"),
    ):
        row = rows[f"index_{part}"]
        assert HUMAN_JOINTS[match.human_near[row]] == f"index_{near}"
        assert HUMAN_JOINTS[match.human_far[row]] == f"index_{far}"
        assert [HUMAN_LINKS[i] for i in match.human_links[row]] == [f"index_{link}"]
    assert HUMAN_JOINTS[match.human_near[rows["thumb_proximal"]]] == "thumb_cmc"


def test_the_last_of_two_links_stands_for_the_rest():
    match, rows = matched("inspire")
    row = rows["ring_middle"]
    assert match.is_last[row]
    assert HUMAN_JOINTS[match.human_near[row]] == "ring_pip"
    assert HUMAN_JOINTS[match.human_far[row]] == "ring_tip"
    assert [HUMAN_LINKS[i] for i in match.human_links[row]] == ["ring_middle", "ring_distal"]


def test_a_missing_finger_is_dropped():
    match, rows = matched("allegro")
    assert not any(row.startswith("pinky") for row in rows)
    assert not any(HUMAN_JOINTS[joint].startswith("pinky") for joint in match.human_far)
    assert not match.link_contacts(flags("pinky_distal", "pinky_middle")).any()


@pytest.mark.parametrize("name", ["human", *ROBOTS])
def test_each_link_goes_from_its_joint_to_the_next(name: str):
    hand = load_hand(name)
    match, rows = matched(name)
    assert match.is_last.sum() == len(hand.fingers)
    assert match.is_thumb.sum() == len(hand.fingers["thumb"].links)
    np.testing.assert_array_equal(match.far, match.near + 1)
    for finger in hand.fingers.values():
        own = [row for link, row in rows.items() if link.startswith(finger.name)]
        assert [hand.keypoint_names[k] for k in match.near[own]] == list(finger.joints)
        assert hand.keypoint_names[match.far[own[-1]]] == finger.tip
        assert all(HUMAN_JOINTS[j].startswith(finger.name) for j in match.human_near[own])


@pytest.mark.parametrize("name", ["human", *ROBOTS])
def test_contacts_go_to_the_links_that_stand_for_the_touching_ones(name: str):
    hand = load_hand(name)
    match, rows = matched(name)
    assert match.link_contacts(np.zeros((2, 16), dtype=bool)).shape == (2, len(hand.links))
    np.testing.assert_array_equal(
        match.link_contacts(flags("palm"))[0], [link == "palm" for link in hand.link_names]
    )
    for link in ("index_distal", "thumb_distal"):
        finger = link.split("_")[0]
        asked = match.link_contacts(flags(link))[0]
        last = max(row for name, row in rows.items() if name.startswith(finger))
        assert np.flatnonzero(asked).tolist() == [1 + last]
    every = match.link_contacts(np.ones((1, 16), dtype=bool))
    assert every.all()
