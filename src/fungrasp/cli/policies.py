"""``fungrasp policies``: list and describe learned policies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from fungrasp.cli.console import Answering, CommandResult, table

if TYPE_CHECKING:
    from fungrasp.policies.checkpoint.card import PolicyCard


@dataclass(frozen=True)
class List(Answering):
    """List the built-in learned policies."""

    def run(self) -> CommandResult:
        from fungrasp.policies.checkpoint.checkpoint_file import list_policies, read_card

        files = list_policies()
        if not files:
            return CommandResult([], "this version has no built-in policies")
        cards = {name: read_card(path) for name, path in files.items()}
        sizes = {name: path.stat().st_size for name, path in files.items()}
        known = [{**card.to_json(), "name": name, "bytes": sizes[name]} for name, card in cards.items()]
        header = ("name", "kind", "hand", "size", "success", "license", "data")
        rows = [
            (
                name,
                card.kind,
                card.hand,
                f"{sizes[name] / 1e3:.0f} kB",
                ", ".join(f"{what} {share:.0%}".strip() for what, share in _successes(card.measured)),
                card.licence,
                ", ".join(data.name for data in card.training_data),
            )
            for name, card in cards.items()
        ]
        return CommandResult(known, table([header, *rows], left=None, widest=30))


@dataclass(frozen=True)
class Info(Answering):
    """Describe a policy: observation, action, training, results, limits."""

    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME|FILE")]
    """A built-in policy, or a policy file (.onnx)."""

    def run(self) -> CommandResult:
        from fungrasp.policies.checkpoint.checkpoint_file import read_card

        card = read_card(self.name)
        return CommandResult(card.to_json(), _text(card))


COMMAND = {"list": List, "info": Info}


def _text(card: PolicyCard) -> str:
    hours = card.budget.seconds / 3600
    rows = [
        ("hand", f"{card.hand} (digest {card.hand_digest[:12]})"),
        ("acts", f"at {card.rate_hz:g} Hz, smoothing {card.action_smoothing:g}"),
        ("license", card.licence),
        ("created", card.created),
        ("revision", card.git_revision),
        ("seed", str(card.seed)),
        ("budget", f"{card.budget.steps:,} steps, {hours:.1f} h on {card.budget.machine}"),
        ("inputs", card.normalisation),
        ("SHA-256", card.sha256),
    ]
    lines = [f"{card.name}: {card.kind}", *(f"  {key:<9} {value}" for key, value in rows if value)]
    parts = {
        "observation": [(part.name, f"{part.size}") for part in card.observation],
        "privileged observation": [(part.name, f"{part.size}") for part in card.privileged],
        "action": [(part.name, f"{part.size}, 1 is {part.scale:g}") for part in card.action],
        "servos (kp [N m/rad], kd [N m s/rad])": [
            (joint, f"{kp:g}, {kd:g}") for joint, (kp, kd) in card.gains.items()
        ],
        "training data": [(data.name, f"{data.count} grasps; {data.terms}") for data in card.training_data],
        "measured": [
            (what, f"{value:.4g}" if isinstance(value, float) else str(value))
            for what, value in _leaves(card.measured)
        ],
    }
    for title, pairs in parts.items():
        if pairs:
            width = max(len(name) for name, _ in pairs)
            lines += ["", title, *(f"  {name:<{width}}  {value}" for name, value in pairs)]
    if card.limits:
        lines += ["", "limits", *(f"  {sentence}" for sentence in card.limits)]
    # Control characters are removed because files may be untrusted.
    return "\n".join("".join(c if c.isprintable() else "?" for c in line) for line in lines)


def _leaves(measured: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of a nested table, each after its path of names."""
    for name, value in measured.items():
        path = f"{above} {name}".strip()
        if isinstance(value, Mapping):
            yield from _leaves(value, path)
        else:
            yield path, value


def _successes(measured: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield each success rate after its path of names."""
    for path, value in _leaves(measured):
        if path.split()[-1] == "success" and isinstance(value, int | float):
            yield path.removesuffix("success").strip(), value
