"""Policies as files: one ONNX file with a card inside, which is checked before anything is run.

The card is the metadata entry ``fungrasp`` of the ONNX model: JSON that begins with the SHA-256 of the whole
file, those 64 digits taken as zeros. The digest is checked before any parser sees the file: a file that was
cut off or changed is refused, whatever was changed. Reading needs ONNX Runtime but neither torch nor the
package ``onnx``, which only writing needs.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.checks import guarded, read_bytes
from fungrasp.core.formats.mujoco_model import read_model_text
from fungrasp.core.formats.onnx_file import LARGEST, check_operators, try_network
from fungrasp.core.formats.text_files import read_toml
from fungrasp.hands import Hand
from fungrasp.policies.checkpoint.card import PolicyCard, card_from_text, card_text
from fungrasp.policies.checkpoint.network import PolicyNetwork

if TYPE_CHECKING:
    from onnx import ModelProto

FOLDER = Path(__file__).parent / "weights"
"""Policies that come with the package, ``<name>.onnx``."""
SUFFIX = ".onnx"
KEY = "fungrasp"
DIGITS = 64
HEAD = '{"sha256": "'
"""What the card begins with."""

Layout = Sequence[tuple[str, int]] | Mapping[str, int]
"""Names and sizes of the parts of a flat vector, in order."""


def save_policy(path: str | Path, model: bytes | ModelProto, card: PolicyCard) -> PolicyCard:
    """Write a policy file, whole or not at all, after trying that it can be loaded.

    Args:
        path: ends in ``.onnx``.
        model: an ONNX model (see ``PolicyNetwork`` for its inputs and outputs), with all weights inside.
        card: what it is; its ``sha256`` is replaced.

    Returns:
        The card with its ``sha256``.

    Raises:
        FungraspError: the model or card is wrong, or the file can't be written; an older file is left as it
            was.
    """
    path = Path(path)
    if path.suffix != SUFFIX:
        raise FungraspError(f"a policy is saved as {SUFFIX}, not {path}")
    try:
        data = _sealed(model, card_text(replace(card, sha256="0" * DIGITS)))
        saved = _network(data, threads=1).card
    except FungraspError as error:
        raise FungraspError(f"{path} is not saved: {error}") from error
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return saved


@guarded("policy")
def load_policy(path_or_name: str | Path, threads: int = 1) -> PolicyNetwork:
    """A policy, ready to run.

    Args:
        path_or_name: a file, or the name of a policy that comes with the package.
        threads: that compute one step.

    Raises:
        FungraspError: no such policy; it is damaged, changed, no policy or of another format; ONNX Runtime
            refuses it (operators that it does not have, weights in another file) or is missing.
    """
    path = _path(path_or_name)
    data = _read(path)
    try:
        return _network(data, threads)
    except FungraspError as error:
        raise FungraspError(f"{path}: {error}") from error


@guarded("policy")
def read_card(path_or_name: str | Path) -> PolicyCard:
    """The card of a policy; the file is checked for damage, and not run.

    Raises:
        FungraspError: no such policy; it is damaged, changed, no policy or of another format.
    """
    path = _path(path_or_name)
    data = _read(path)
    try:
        return _card(data)
    except FungraspError as error:
        raise FungraspError(f"{path}: {error}") from error


def list_policies() -> dict[str, Path]:
    """Files of the policies that come with the package, by name."""
    return {path.stem: path for path in sorted(FOLDER.glob(f"*{SUFFIX}"))}


def find_policy(name: str) -> Path:
    """File of a policy that comes with the package.

    Raises:
        UnknownNameError: there is none of this name.
    """
    policies = list_policies()
    if name not in policies:
        raise UnknownNameError("policy", name, policies)
    return policies[name]


def servo_gains(hand: Hand) -> dict[str, tuple[float, float]]:
    """Stiffness [N m/rad] and damping [N m s/rad] of each servo, by joint, in their order."""
    return {joint: (servo.kp, servo.kd) for joint, servo in hand.actuators.items()}


def hand_digest(hand: Hand) -> str:
    """SHA-256 of what a hand's TOML and model file say, in hexadecimal.

    Comments, spaces and line ends don't count, nor do the hand's title and sources. Mesh files that a model
    names are not looked into.

    Raises:
        FungraspError: a file can't be read.
    """
    try:
        table = read_toml(hand.path, "hand file")
        model = ElementTree.canonicalize(read_model_text(hand.model_path), strip_text=True)
    except FungraspError as error:
        raise FungraspError(f"cannot read the files of hand '{hand.name}': {error}") from error
    for key in ("title", "source"):
        table.pop(key, None)
    table["actuators"].pop("source", None)
    return hashlib.sha256(f"{json.dumps(table, sort_keys=True, default=str)}\n{model}".encode()).hexdigest()


def check_fits(
    card: PolicyCard,
    hand: Hand,
    observation_layout: Layout,
    privileged_layout: Layout,
    rate: float,
) -> None:
    """Refuse a policy that was made for something else.

    Args:
        card: of the policy.
        hand: that it should move.
        observation_layout: parts of the observation that it would get, in order.
        privileged_layout: those of the privileged observation; not looked at for a student.
        rate: how often it would act [Hz].

    Raises:
        FungraspError: they differ; the message says in what.
    """
    found = _hand_differences(card, hand)
    found += _layout_differences("observation", card.observation, observation_layout)
    if card.kind == "teacher":
        found += _layout_differences("privileged observation", card.privileged, privileged_layout)
    if abs(card.rate_hz - rate) > 1e-6 * card.rate_hz:
        found.append(f"it acts at {card.rate_hz:g} Hz, here at {rate:g} Hz")
    if found:
        raise FungraspError(f"policy '{card.name}' does not fit: {'; '.join(found)}")


def _hand_differences(card: PolicyCard, hand: Hand) -> list[str]:
    if card.hand != hand.name:
        return [f"it was made for the hand '{card.hand}', not '{hand.name}'"]
    gains = servo_gains(hand)
    if tuple(gains) != card.joint_names:
        return [f"its joints are {', '.join(card.joint_names)}, those of '{hand.name}' {', '.join(gains)}"]
    changed = [
        f"{joint} kp {card.gains[joint][0]:g}, kd {card.gains[joint][1]:g}, not {kp:g}, {kd:g}"
        for joint, (kp, kd) in gains.items()
        if (kp, kd) != tuple(card.gains[joint])
    ]
    if changed:
        more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
        return [f"it was made for other servo gains: {changed[0]}{more}"]
    if hand_digest(hand) != card.hand_digest:
        return [f"the model of the hand '{hand.name}' has changed since it was made"]
    return []


def _layout_differences(what: str, wanted: Layout, given: Layout) -> list[str]:
    theirs, ours = dict(wanted), dict(given)
    if list(theirs.items()) == list(ours.items()):
        return []
    found = [f"its {what} has '{name}', which is missing here" for name in theirs if name not in ours]
    found += [f"its {what} lacks '{name}'" for name in ours if name not in theirs]
    found += [
        f"'{name}' of its {what} has {size} numbers, here {ours[name]}"
        for name, size in theirs.items()
        if name in ours and ours[name] != size
    ]
    return found or [f"its {what} is in the order {', '.join(theirs)}, here {', '.join(ours)}"]


def _path(path_or_name: str | Path) -> Path:
    known = list_policies()
    if str(path_or_name) in known:
        return known[str(path_or_name)]
    path = Path(path_or_name)
    if path.suffix == SUFFIX or isinstance(path_or_name, Path) or path.is_file():
        return path
    return find_policy(str(path_or_name))


def _read(path: Path) -> bytes:
    return read_bytes(path, "policy", LARGEST)


def _sealed(model: bytes | ModelProto, text: str) -> bytes:
    """An ONNX file with this text as its only card, whose digits are those of the file's digest.

    Raises:
        FungraspError: the package ``onnx`` is missing, or the bytes are no ONNX model.
    """
    try:
        import onnx
    except ImportError as error:
        raise FungraspError(
            'writing a policy needs the package onnx: pip install "fungrasp[learning]"'
        ) from error
    try:
        sealed = onnx.load_from_string(model if isinstance(model, bytes) else model.SerializeToString())
        others = {entry.key: entry.value for entry in sealed.metadata_props if entry.key != KEY}
        onnx.helper.set_model_props(sealed, {**others, KEY: text})
        data = sealed.SerializeToString(deterministic=True)
    except Exception as error:
        raise FungraspError(f"not an ONNX model: {error}") from error
    at = _digest_offset(data)
    return data[:at] + _digest(data, at).encode() + data[at + DIGITS :]


def _network(data: bytes, threads: int) -> PolicyNetwork:
    card = _card(data)
    try_network(data)
    return PolicyNetwork(data, card, threads)


def _card(data: bytes) -> PolicyCard:
    """The card in a file's bytes, once its digest is found right."""
    at = _digest_offset(data)
    said, found = data[at : at + DIGITS].decode("ascii", errors="replace"), _digest(data, at)
    if said != found:
        raise FungraspError(
            f"damaged or changed since it was saved: its SHA-256 is {found[:12]}..., "
            f"its card says {said[:12]}..."
        )
    # What is run is arithmetic alone: no loops, functions or foreign operators.
    check_operators(data)
    text = data[at - len(HEAD) :].decode(errors="surrogateescape")
    try:
        # The card ends where its JSON does; what follows in the file is none of it.
        text = text[: json.JSONDecoder().raw_decode(text)[1]]
    except RecursionError as error:
        raise FungraspError("its policy card is nested too deeply") from error
    except ValueError as error:
        raise FungraspError(f"its policy card is not valid JSON: {error}") from error
    return replace(card_from_text(text), sha256=found)


def _digest_offset(data: bytes) -> int:
    """Where the digest's digits are."""
    head = HEAD.encode()
    if data.count(head) > 1:
        raise FungraspError("it has several policy cards")
    at = data.find(head)
    if at < 0:
        raise FungraspError("not a policy file: it has no policy card")
    return at + len(head)


def _digest(data: bytes, at: int) -> str:
    digest = hashlib.sha256(data[:at])
    digest.update(b"0" * DIGITS)
    digest.update(data[at + DIGITS :])
    return digest.hexdigest()
