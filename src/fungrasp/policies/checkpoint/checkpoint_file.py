"""Policy files: an ONNX file that contains a card and is checked before anything is run.

The card is the metadata entry ``fungrasp`` of the ONNX model: JSON that begins with the SHA-256 of the whole
file, computed with zeros in place of its 64 digits. The digest is checked before any parser reads the file,
so a truncated or modified file is always rejected. Reading needs ONNX Runtime but neither torch nor the
package ``onnx``, which is only needed for writing.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.files import atomic_path, check_suffix
from fungrasp.core.formats.checks import guarded, read_bytes
from fungrasp.core.formats.mujoco_model import read_model_text
from fungrasp.core.formats.onnx_file import LARGEST, check_operators, try_network
from fungrasp.core.formats.text_files import read_toml
from fungrasp.hands import Hand
from fungrasp.policies.checkpoint.card import PolicyCard, card_from_text, card_text

if TYPE_CHECKING:
    from onnx import ModelProto

FOLDER = Path(__file__).parent / "weights"
"""Folder of the built-in policies, ``<name>.onnx``."""
SUFFIX = ".onnx"
KEY = "fungrasp"
DIGITS = 64
HEAD = '{"sha256": "'
"""First characters of the card."""

OBSERVATION, ACTION = "observation", "action"
STATE, NEXT_STATE = "state_", "next_state_"
"""Prefixes of the graph's states: input ``state_<x>`` gets the output ``next_state_<x>`` of the previous
step."""
TYPES: Mapping[str, Any] = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
    "tensor(bool)": np.bool_,
}
"""Number types of states."""
NAMED = 5
"""Largest number of worlds listed in an error message."""

State = dict[str, np.ndarray]
"""Memory of a policy, by name; the first axis of each array is the world, shape [W, ...]."""

Layout = Sequence[tuple[str, int]] | Mapping[str, int]
"""Names and sizes of the parts of a flat vector, in order."""


def save_policy(path: str | Path, model: bytes | ModelProto, card: PolicyCard) -> PolicyCard:
    """Write a policy file atomically, after checking that it can be loaded.

    Args:
        path: ends in ``.onnx``.
        model: an ONNX model (see ``PolicyNetwork`` for its inputs and outputs) with all weights inside.
        card: its card; ``sha256`` is replaced.

    Returns:
        The card with its ``sha256``.

    Raises:
        FungraspError: the model or card is invalid, or the file can't be written; an existing file is kept.
    """
    path = check_suffix(path, "a policy", SUFFIX)
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
    """Load a policy.

    Args:
        path_or_name: a file, or the name of a built-in policy.

    Raises:
        FungraspError: there is no such policy; the file is damaged, changed, not a policy or of another
            format; ONNX Runtime is missing or rejects it (unknown operators, external weights).
    """
    path = _path(path_or_name)
    data = _read(path)
    try:
        return _network(data, threads)
    except FungraspError as error:
        raise FungraspError(f"{path}: {error}") from error


@guarded("policy")
def read_card(path_or_name: str | Path) -> PolicyCard:
    """Read the card of a policy. The file is checked for damage but not run.

    Raises:
        FungraspError: there is no such policy; the file is damaged, changed, not a policy or of another
            format.
    """
    path = _path(path_or_name)
    data = _read(path)
    try:
        return _card(data)
    except FungraspError as error:
        raise FungraspError(f"{path}: {error}") from error


def list_policies() -> dict[str, Path]:
    """Return the files of the built-in policies, by name."""
    return {path.stem: path for path in sorted(FOLDER.glob(f"*{SUFFIX}"))}


def find_policy(name: str) -> Path:
    """Return the file of a built-in policy.

    Raises:
        FungraspError: there is no policy of this name, or there is one for each hand.
    """
    policies = list_policies()
    if name not in policies:
        of_hands = [one for one in policies if f"-{name}-" in one]
        if of_hands:
            raise FungraspError(f"each hand has its own {name}; name one: {', '.join(of_hands)}")
        raise UnknownNameError("policy", name, policies)
    return policies[name]


def servo_gains(hand: Hand) -> dict[str, tuple[float, float]]:
    """Return stiffness [N m/rad] and damping [N m s/rad] of each servo, by joint, in order."""
    return {joint: (servo.kp, servo.kd) for joint, servo in hand.actuators.items()}


def hand_digest(hand: Hand) -> str:
    """Return the SHA-256 of a hand's TOML and model file, in hexadecimal.

    Comments, whitespace, title and sources of the hand are ignored. Mesh files of the model are not read.

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
    """Check that a policy fits hand, observations and control rate.

    Args:
        observation_layout: parts of the observation, in order.
        privileged_layout: parts of the privileged observation; ignored for a student.
        rate: control rate [Hz].

    Raises:
        FungraspError: the policy does not fit; the message lists the differences.
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
    """Return an ONNX file with this text as its only card, and insert the file's digest.

    Raises:
        FungraspError: the package ``onnx`` is missing, or the data are not an ONNX model.
    """
    try:
        import onnx
    except ImportError as error:
        raise FungraspError(
            'writing a policy needs the package onnx: pip install ".[learning]" in the clone'
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
    """Return the card in a file's content, after checking the digest."""
    at = _digest_offset(data)
    said, found = data[at : at + DIGITS].decode("ascii", errors="replace"), _digest(data, at)
    if said != found:
        raise FungraspError(
            f"damaged or changed since it was saved: its SHA-256 is {found[:12]}..., "
            f"its card says {said[:12]}..."
        )
    # Only arithmetic is allowed: no loops, functions or foreign operators.
    check_operators(data)
    text = data[at - len(HEAD) :].decode(errors="surrogateescape")
    try:
        # The card ends with its JSON value; the rest of the file follows.
        text = text[: json.JSONDecoder().raw_decode(text)[1]]
    except RecursionError as error:
        raise FungraspError("its policy card is nested too deeply") from error
    except ValueError as error:
        raise FungraspError(f"its policy card is not valid JSON: {error}") from error
    return replace(card_from_text(text), sha256=found)


def _digest_offset(data: bytes) -> int:
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


class PolicyNetwork:
    """A policy's graph with its card. It is stateless: memory is passed in and returned."""

    def __init__(self, model: bytes, card: PolicyCard, threads: int = 1):
        """
        Args:
            model: an ONNX file with inputs ``observation`` [W, O] and any ``state_<x>`` [W, ...], outputs
                ``action`` [W, A], a ``next_state_<x>`` for each state, and any others. W must be dynamic.

        Raises:
            FungraspError: ONNX Runtime is missing or rejects the graph, or the graph does not match the card.
        """
        self.card = card
        self._size = card.input_size
        self._session = _session(model, threads)
        inputs = {put.name: put for put in self._session.get_inputs()}
        self._outputs = [put.name for put in self._session.get_outputs()]
        _check_vector(inputs.pop(OBSERVATION, None), OBSERVATION, card.input_size)
        actions = {put.name: put for put in self._session.get_outputs()}
        _check_vector(actions.get(ACTION), ACTION, card.action_size)
        self._states: dict[str, tuple[Any, tuple[int, ...]]] = {}
        for name, put in inputs.items():
            if not name.startswith(STATE):
                raise FungraspError(
                    f"the graph has an input '{name}'; there may be '{OBSERVATION}' and '{STATE}...'"
                )
            if NEXT_STATE + name.removeprefix(STATE) not in self._outputs:
                raise FungraspError(f"the graph has an input '{name}' and no output 'next_{name}'")
            _check_open(put)
            if put.type not in TYPES or not all(isinstance(size, int) for size in put.shape[1:]):
                raise FungraspError(
                    f"the graph's input '{name}' has no fixed shape and number type per world"
                )
            self._states[name.removeprefix(STATE)] = TYPES[put.type], tuple(put.shape[1:])
        for name in self._outputs:
            if name.startswith(NEXT_STATE) and name.removeprefix(NEXT_STATE) not in self._states:
                raise FungraspError(f"the graph has an output '{name}' and no input '{name[5:]}'")

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the graph's outputs besides the action and the next state."""
        return tuple(name for name in self._outputs if name != ACTION and not name.startswith(NEXT_STATE))

    def initial_state(self, worlds: int) -> State:
        """Return the memory at the start of an episode: zeros, shape [worlds, ...] each; empty for a policy
        without memory."""
        return {name: np.zeros((worlds, *shape), kind) for name, (kind, shape) in self._states.items()}

    def __call__(
        self, observation: np.ndarray, state: Mapping[str, np.ndarray] | None = None
    ) -> tuple[np.ndarray, dict[str, np.ndarray], State]:
        """Run one step in W worlds.

        Args:
            observation: concatenated ``inputs`` of the card, not normalized, shape [W, O].
            state: from ``initial_state`` or the previous step; may be None for a policy without memory.

        Returns:
            The action, shape [W, A], neither scaled nor smoothed; the graph's other outputs by name
            ("contacts", "forces", ...), shape [W, ...] each; the state for the next step.

        Raises:
            FungraspError: a shape or state is wrong, an input or the action is NaN or infinite, or the graph
                can't be computed.
        """
        observation = self._checked(observation)
        worlds = len(observation)
        feed = {OBSERVATION: observation}
        state = state or {}
        if set(state) != set(self._states):
            raise FungraspError(
                f"{self._name} remembers {_list(self._states)}, the given state has {_list(state)}"
            )
        for name, (kind, shape) in self._states.items():
            if np.shape(state[name]) != (worlds, *shape):
                raise FungraspError(
                    f"state '{name}' of {self._name} must have shape {(worlds, *shape)}, "
                    f"not {np.shape(state[name])}"
                )
            feed[STATE + name] = np.ascontiguousarray(state[name], dtype=kind)
        try:
            values = self._session.run(self._outputs, feed)
        except Exception as error:
            raise FungraspError(f"{self._name} can't run: {' '.join(str(error).split())}") from error
        outputs = dict(zip(self._outputs, values, strict=True))
        action = outputs.pop(ACTION)
        self._refuse_infinite("gave an action with", action, self.card.action)
        after = {name: outputs.pop(NEXT_STATE + name) for name in self._states}
        return action, outputs, after

    @property
    def _name(self) -> str:
        return f"policy '{self.card.name}'"

    def _checked(self, observation: np.ndarray) -> np.ndarray:
        """Return the array in single precision, after checking that its shape is right and it is finite."""
        given = np.asarray(observation)
        if given.ndim != 2 or given.shape[1] != self._size:
            layout = ", ".join(f"{part.name} {part.size}" for part in self.card.inputs)
            raise FungraspError(
                f"{self._name} takes observations of shape [W, {self.card.input_size}] ({layout}), "
                f"not {list(given.shape)}"
            )
        single = given
        if given.dtype != np.float32 or not given.flags.c_contiguous:
            with np.errstate(over="ignore"):
                single = np.ascontiguousarray(given, dtype=np.float32)
        self._refuse_infinite("was given", single, self.card.inputs)
        return single

    def _refuse_infinite(self, verb: str, values: np.ndarray, parts: tuple[Any, ...]) -> None:
        finite = np.isfinite(values)
        if finite.all():
            return
        columns = np.flatnonzero(~finite.all(axis=0))
        names = [part.name for part in parts for _ in range(part.size)]
        found = _list(dict.fromkeys(names[column] for column in columns))
        worlds = np.flatnonzero(~finite.all(axis=1))
        more = f" and {len(worlds) - NAMED} more" if len(worlds) > NAMED else ""
        where = ", ".join(str(world) for world in worlds[:NAMED])
        raise FungraspError(
            f"{self._name} {verb} NaN or infinite numbers in {found}, "
            f"world{'s' * (len(worlds) > 1)} {where}{more}"
        )


def onnx_runtime() -> ModuleType:
    """Return the package ``onnxruntime`` with telemetry off.

    Raises:
        FungraspError: it is not installed.
    """
    # The library reads this variable once, when it is loaded.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    try:
        import onnxruntime
    except ImportError as error:
        raise FungraspError(
            "a learned policy runs on ONNX Runtime, which is not installed: pip install onnxruntime "
            '(training also needs: pip install ".[learning]" in the clone)'
        ) from error
    onnxruntime.disable_telemetry_events()
    return onnxruntime


def _session(model: bytes, threads: int) -> Any:
    runtime = onnx_runtime()
    if threads < 1:
        raise FungraspError(f"a policy needs at least one thread, not {threads}")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    options.add_session_config_entry("session.load_model_format", "ONNX")
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # Weights must be inside the file: external weights would be searched in a folder that can't exist.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", os.devnull)
    try:
        return runtime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise FungraspError(f"ONNX Runtime can't run it: {' '.join(str(error).split())}") from error


def _check_vector(put: Any, name: str, size: int) -> None:
    if put is None:
        raise FungraspError(f"the graph has no '{name}'")
    _check_open(put)
    if put.type != "tensor(float)" or put.shape[1:] != [size]:
        raise FungraspError(
            f"the graph's '{name}' is {put.type} {put.shape}; by its card it should be float [W, {size}]"
        )


def _check_open(put: Any) -> None:
    if not put.shape or isinstance(put.shape[0], int):
        raise FungraspError(
            f"the graph's '{put.name}' has shape {put.shape}; its first axis, the world, must be left open"
        )


def _list(names: Any) -> str:
    return ", ".join(f"'{name}'" for name in names) or "nothing"
