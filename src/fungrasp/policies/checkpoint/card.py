"""The card of a policy file: purpose, interface, and provenance of a policy."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from datetime import datetime
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from fungrasp.core.errors import FungraspError
from fungrasp.core.formats.text_files import parse_json
from fungrasp.task.features import LayoutName, check_layout

FORMAT_VERSION = 1
SEARCH = "search"
"""``PolicyCard.plans`` of policies that follow the best of many plans."""
KINDS = ("teacher", "student", "predictor")


class Part(NamedTuple):
    """A named block of numbers in a flat vector."""

    name: str
    """Name of the quantity, for example "joint_positions"."""
    size: int
    """Number of values."""


class ActionPart(NamedTuple):
    """A named block of numbers in the flat action."""

    name: str
    """What the numbers move, for example "fingers"."""
    size: int
    """Number of values."""
    scale: float
    """Effect of an action of 1, in the unit of the part (m, rad)."""


class TrainingData(NamedTuple):
    """Set of grasps used for training."""

    name: str
    """Name of the data set."""
    terms: str
    """Terms of use."""
    count: int
    """Number of grasps."""


class Budget(NamedTuple):
    """Cost of training."""

    steps: int
    """Control steps of all worlds together."""
    seconds: float
    """Duration of training [s]."""
    machine: str
    """Description of the machine."""


@dataclass(frozen=True)
class PolicyCard:
    """Purpose, interface and provenance of a policy.

    The graph's input is a flat vector of the parts of ``observation``, then those of ``privileged``; both are
    normalized inside the graph.
    """

    name: str
    """Name of the policy; for built-in policies, the name of the file."""
    kind: str
    """One of ``KINDS``. A teacher gets privileged observations, a student only sensor data. Predictors of
    older versions rated plans."""
    hand: str
    """Name of the hand."""
    hand_digest: str
    """``hand_digest`` of the hand used in training."""
    joint_names: tuple[str, ...]
    """Names of the independent joints, in the order of servos and of the action."""
    gains: Mapping[str, tuple[float, float]]
    """Servo stiffness [N m/rad] and damping [N m s/rad], by joint."""
    rate_hz: float
    """Control rate [Hz]."""
    observation: tuple[Part, ...]
    """Parts of the observation, in the order of the graph's input."""
    action: tuple[ActionPart, ...]
    """Parts of the action, in the order of the graph's output."""
    budget: Budget
    """Cost of training."""
    privileged: tuple[Part, ...] = ()
    """Parts of the privileged observation; empty for a student."""
    layout_name: LayoutName = "full"
    """Name of the observation layout (``fungrasp.task.features``)."""
    plans: str = ""
    """``SEARCH``, or in older files the name of a success predictor, if the policy follows the best of many
    plans, selected by rollouts; "" if it follows one plan per grasp."""
    action_smoothing: float = 0.0
    """Weight of the previous smoothed action in the next one, in [0, 1); the new action has the rest."""
    normalisation: str = "mean and standard deviation are inside the graph"
    """How to normalize observations before passing them to the graph, in words."""
    training_data: tuple[TrainingData, ...] = ()
    """Sets of grasps used for training."""
    git_revision: str = ""
    """Commit used for training; empty if unknown."""
    seed: int = 0
    """Random seed of training."""
    measured: Mapping[str, Any] = field(default_factory=dict)
    """Numbers and nested tables of numbers, by measurement; success rates are called "success"."""
    licence: str = ""
    """License of the file, for example "Apache-2.0"."""
    limits: tuple[str, ...] = ()
    """Known limits of the policy, as sentences."""
    created: str = ""
    """Date or time, ISO 8601."""
    format_version: int = FORMAT_VERSION
    """Version of the card's format."""
    sha256: str = ""
    """Digest of the file with these 64 digits set to zeros; set when saving and loading."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is invalid.
        """
        if self.kind not in KINDS:
            raise FungraspError(f"a policy is a {' or a '.join(KINDS)}, not '{self.kind}'")
        if self.kind != "teacher" and self.privileged:
            raise FungraspError(f"a {self.kind} can't have privileged observations")
        if not 0 < self.rate_hz < math.inf:
            raise FungraspError(f"rate_hz must be positive, not {self.rate_hz}")
        if not 0 <= self.action_smoothing < 1:
            raise FungraspError(f"action_smoothing must be in [0, 1), not {self.action_smoothing}")
        if list(self.gains) != list(self.joint_names):
            raise FungraspError(
                f"gains must be given for the joints {', '.join(self.joint_names)}, in this order"
            )
        check_layout(self.layout_name)
        for parts in (self.inputs, self.action):
            names = [part.name for part in parts]
            if not parts or len(set(names)) < len(names) or any(part.size < 1 for part in parts):
                raise FungraspError("observation and action need parts of size 1 or more, each name once")
        if self.created:
            try:
                datetime.fromisoformat(self.created)
            except ValueError as error:
                raise FungraspError(
                    f"created must be a date or time in ISO 8601, not '{self.created}'"
                ) from error

    @property
    def inputs(self) -> tuple[Part, ...]:
        """Parts of the graph's flat input."""
        return self.observation + self.privileged

    @property
    def input_size(self) -> int:
        """Length of the graph's input, O."""
        return sum(part.size for part in self.inputs)

    @property
    def action_size(self) -> int:
        """Length of the action, A."""
        return sum(part.size for part in self.action)

    def to_json(self) -> dict[str, Any]:
        """Return the card as JSON values."""
        values: dict[str, Any] = {}
        for name, value in asdict(self).items():
            if isinstance(value, Budget):
                value = value._asdict()
            elif isinstance(value, tuple):
                value = [item._asdict() if hasattr(item, "_asdict") else item for item in value]
            elif name == "gains":
                value = {joint: list(pair) for joint, pair in value.items()}
            values[name] = value
        return values


def card_text(card: PolicyCard) -> str:
    """Return the card as JSON text, ``sha256`` first.

    Raises:
        FungraspError: the card has a value that JSON cannot represent, such as NaN.
    """
    values = card.to_json()
    try:
        return json.dumps({"sha256": values.pop("sha256"), **values}, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise FungraspError(f"the card of policy '{card.name}' can't be written: {error}") from error


def card_from_text(text: str | bytes) -> PolicyCard:
    """Parse a card from JSON text. Unknown fields are ignored.

    Raises:
        FungraspError: the text is not a card or has a different format version.
    """
    values = parse_json(text, "its policy card")
    if not isinstance(values, dict):
        raise FungraspError("its policy card is not a table")
    version = values.get("format_version")
    if version != FORMAT_VERSION:
        raise FungraspError(
            f"its policy card has format {version!r}; this version of fungrasp reads {FORMAT_VERSION}"
        )
    hints = get_type_hints(PolicyCard)
    needed = [f.name for f in fields(PolicyCard) if f.default is MISSING and f.default_factory is MISSING]
    for name in needed:
        if name not in values:
            raise FungraspError(f"its policy card lacks '{name}'")
    return PolicyCard(
        **{name: _value(name, hints[name], value) for name, value in values.items() if name in hints}
    )


def _value(name: str, kind: Any, value: Any) -> Any:
    """Convert a JSON value to the type ``kind``; ``name`` is for error messages."""
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if get_origin(kind) is Literal and isinstance(value, str):
        return value
    if kind in (int, str) and isinstance(value, kind) and not isinstance(value, bool):
        return value
    if origin is Mapping and isinstance(value, dict):
        return {key: _value(f"{name}.{key}", arguments[1], item) for key, item in value.items()}
    if origin is tuple and isinstance(value, list):
        kinds = [arguments[0]] * len(value) if arguments[-1] is ... else arguments
        if len(kinds) == len(value):
            pairs = zip(kinds, value, strict=True)
            return tuple(_value(f"{name}[{i}]", *pair) for i, pair in enumerate(pairs))
    if kind in (Part, ActionPart, TrainingData, Budget) and isinstance(value, dict):
        hints = get_type_hints(kind)
        if set(hints) <= set(value):
            return kind(**{key: _value(f"{name}.{key}", hint, value[key]) for key, hint in hints.items()})
    raise FungraspError(f"its policy card has {value!r} where '{name}' belongs")
