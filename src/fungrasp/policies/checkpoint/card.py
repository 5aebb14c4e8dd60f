"""The card of a policy file: what the policy is for, how it is run, where it comes from."""

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
    """A run of numbers in a flat vector."""

    name: str
    """What the numbers are, "joint_positions"."""
    size: int
    """How many numbers."""


class ActionPart(NamedTuple):
    """A run of numbers in the flat action."""

    name: str
    """What the numbers move, "fingers"."""
    size: int
    """How many numbers."""
    scale: float
    """What an action of 1 means, in the unit of the part (m, rad)."""


class TrainingData(NamedTuple):
    """Grasps that a policy was trained on."""

    name: str
    """Name of the data set."""
    terms: str
    """Under what terms they may be used."""
    count: int
    """How many grasps."""


class Budget(NamedTuple):
    """What training took."""

    steps: int
    """Control steps of all worlds together."""
    seconds: float
    """How long training took [s]."""
    machine: str
    """The machine it ran on, in words."""


@dataclass(frozen=True)
class PolicyCard:
    """What a policy is for, how it is to be run, and where it comes from.

    The graph's input is one flat vector, the parts of ``observation`` and after them those of ``privileged``;
    the normalisation of both is inside the graph.
    """

    name: str
    """Name of the policy; that of its file if it comes with the package."""
    kind: str
    """One of ``KINDS``: a teacher sees what only a simulation knows, a student what a robot has;
    predictors of older versions judged plans."""
    hand: str
    """Name of the hand that it moves."""
    hand_digest: str
    """``hand_digest`` of the hand that it was trained for."""
    joint_names: tuple[str, ...]
    """Names of the independent joints, in the order of servos and of the action."""
    gains: Mapping[str, tuple[float, float]]
    """Servo stiffness [N m/rad] and damping [N m s/rad], by joint."""
    rate_hz: float
    """How often it acts [Hz]."""
    observation: tuple[Part, ...]
    """What it sees, in the order of the graph's input."""
    action: tuple[ActionPart, ...]
    """What it does, in the order of the graph's output."""
    budget: Budget
    """What training took."""
    privileged: tuple[Part, ...] = ()
    """What it sees that only a simulation knows; nothing for a student."""
    layout_name: LayoutName = "full"
    """Name of the layout of what it sees (``fungrasp.task.features``)."""
    plans: str = ""
    """``SEARCH``, or the name of a success predictor in older files, if it follows the best of many plans,
    which rollouts choose; "" if the grasp's own."""
    action_smoothing: float = 0.0
    """Weight of the previous smoothed action in the next one, in [0, 1); the new action has the rest."""
    normalisation: str = "mean and standard deviation are inside the graph"
    """How observations are to be normalized before they are given to the graph, in words."""
    training_data: tuple[TrainingData, ...] = ()
    """Sets of grasps that it has learned from."""
    git_revision: str = ""
    """The commit that trained it; empty if unknown."""
    seed: int = 0
    """Seed of its training."""
    measured: Mapping[str, Any] = field(default_factory=dict)
    """Numbers and nested tables of numbers, by what was measured; a share of successes is called
    "success"."""
    licence: str = ""
    """Under what terms the file may be used, "Apache-2.0"."""
    limits: tuple[str, ...] = ()
    """Sentences: where it fails, what it was not made for."""
    created: str = ""
    """Date or time, ISO 8601."""
    format_version: int = FORMAT_VERSION
    """Version of the card's format."""
    sha256: str = ""
    """Digest of the file with these 64 digits taken as zeros; given by saving and loading."""

    def __post_init__(self) -> None:
        """
        Raises:
            FungraspError: a value is impossible.
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
        """Parts of the flat vector that the graph takes."""
        return self.observation + self.privileged

    @property
    def input_size(self) -> int:
        """Length of that vector, O."""
        return sum(part.size for part in self.inputs)

    @property
    def action_size(self) -> int:
        """Length of the action, A."""
        return sum(part.size for part in self.action)

    def to_json(self) -> dict[str, Any]:
        """The card as plain lists, tables, numbers and text."""
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
    """The card as JSON, ``sha256`` first.

    Raises:
        FungraspError: the card holds something that JSON can't, NaN included.
    """
    values = card.to_json()
    try:
        return json.dumps({"sha256": values.pop("sha256"), **values}, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise FungraspError(f"the card of policy '{card.name}' can't be written: {error}") from error


def card_from_text(text: str | bytes) -> PolicyCard:
    """A card from JSON. Fields that this version doesn't know are left out.

    Raises:
        FungraspError: the text is no card, or one of a later format.
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
    """A value of the type ``kind`` from JSON; ``name`` is for the message."""
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
