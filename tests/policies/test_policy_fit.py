"""Cards that make no sense, and policies that were made for something else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from small_policies import OBSERVATION, allegro_card

from fungrasp.core.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.hands.hand import read_hand_toml
from fungrasp.policies.checkpoint.card import Part, PolicyCard, card_from_text, card_text
from fungrasp.policies.checkpoint.checkpoint_file import (
    check_fits,
    hand_digest,
)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "master"}, "a teacher or a student"),
        ({"privileged": (Part("forces", 2),)}, "student can't have privileged"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"action_smoothing": 1.0}, "action_smoothing"),
        ({"gains": {}}, "gains must be given for the joints"),
        ({"observation": ()}, "parts of size 1 or more"),
        ({"observation": (Part("a", 3), Part("a", 2))}, "each name once"),
        ({"observation": (Part("a", 0),)}, "size 1 or more"),
        ({"created": "yesterday"}, "ISO 8601"),
    ],
)
def test_cards_that_make_no_sense(changes: dict, message: str) -> None:
    with pytest.raises(FungraspError, match=message):
        allegro_card(**changes)


def fits(card: PolicyCard, **changes) -> None:
    given = {
        "hand": load_hand("allegro"),
        "observation_layout": OBSERVATION,
        "privileged_layout": (),
        "rate": 10.0,
    }
    check_fits(card, **(given | changes))


def test_what_it_was_made_for_fits() -> None:
    fits(allegro_card())
    fits(allegro_card(), privileged_layout=(Part("forces", 13),))
    fits(allegro_card(), observation_layout={"joint_positions": 3, "wrist_velocity": 2})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hand": load_hand("leap")}, "does not fit: it was made for the hand 'allegro', not 'leap'$"),
        ({"rate": 20.0}, "it acts at 10 Hz, here at 20 Hz"),
        (
            {"observation_layout": OBSERVATION[:1]},
            "its observation has 'wrist_velocity', which is missing here",
        ),
        ({"observation_layout": (*OBSERVATION, Part("new", 1))}, "its observation lacks 'new'"),
        (
            {"observation_layout": (OBSERVATION[0], Part("wrist_velocity", 6))},
            "'wrist_velocity' of its observation has 2 numbers, here 6",
        ),
        (
            {"observation_layout": OBSERVATION[::-1]},
            "in the order joint_positions, wrist_velocity, here wrist_velocity, joint_positions",
        ),
        ({"rate": 20.0, "observation_layout": OBSERVATION[:1]}, "missing here; it acts at 10 Hz"),
    ],
)
def test_what_it_was_not_made_for(changes: dict, message: str) -> None:
    with pytest.raises(FungraspError, match=message):
        fits(allegro_card(), **changes)


def test_a_teacher_needs_its_privileged_parts() -> None:
    card = allegro_card(kind="teacher", privileged=(Part("forces", 13),))
    with pytest.raises(FungraspError, match="its privileged observation has 'forces', which is missing here"):
        fits(card)
    fits(card, privileged_layout=(Part("forces", 13),))


def test_another_order_of_joints_or_other_gains() -> None:
    card = allegro_card()
    turned = tuple(reversed(card.joint_names))
    with pytest.raises(FungraspError, match=f"its joints are {turned[0]}, {turned[1]}"):
        fits(replace(card, joint_names=turned, gains={name: card.gains[name] for name in turned}))
    stiff = {name: (9.0, kd) for name, (_, kd) in card.gains.items()}
    with pytest.raises(
        FungraspError,
        match=rf"other servo gains: {card.joint_names[0]} kp 9, kd 0\.15, not 4, 0\.15 and 15 more",
    ):
        fits(replace(card, gains=stiff))


@pytest.fixture
def copy_of_allegro(tmp_path: Path) -> Path:
    hand = load_hand("allegro")
    for path in (hand.path, hand.model_path):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path / hand.path.name


@pytest.mark.parametrize(
    ("file", "old", "new", "same"),
    [
        ("hand.toml", "\n", "\r\n", True),
        ("allegro.xml", "\n", "\r\n", True),
        ("allegro.xml", "<worldbody>", "<!-- note -->\n   <worldbody>", True),
        ("hand.toml", 'title = "', 'title = "My ', True),
        ("hand.toml", "force_limit = 0.7", "force_limit = 0.8", False),
        ("allegro.xml", 'name="ff_tip_centre" pos="', 'name="ff_tip_centre" pos="0.00', False),
    ],
)
def test_a_hand_is_another_when_its_files_say_something_else(copy_of_allegro, file, old, new, same) -> None:
    path = copy_of_allegro.parent / file
    text = path.read_text()
    assert old in text
    path.write_bytes(text.replace(old, new).encode())
    changed = read_hand_toml(copy_of_allegro)
    assert (hand_digest(changed) == hand_digest(load_hand("allegro"))) is same
    if same:
        fits(allegro_card(), hand=changed)
        return
    with pytest.raises(FungraspError, match="the model of the hand 'allegro' has changed since"):
        fits(allegro_card(), hand=changed)


def test_a_layout_that_is_not_known() -> None:
    text = card_text(allegro_card())
    assert card_from_text(text.replace('"layout_name": "full", ', "")).layout_name == "full", "older files"
    with pytest.raises(FungraspError, match=r"^unknown observation layout 'tiny'. Known: full, paper.$"):
        card_from_text(text.replace('"layout_name": "full"', '"layout_name": "tiny"'))
