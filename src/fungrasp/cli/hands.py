"""``fungrasp hands``: list, show, add, check and export robot hands."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from fungrasp.cli.console import Answering, CommandResult, option, suggestion, table

if TYPE_CHECKING:
    from fungrasp.hands.findings import Finding

HandName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]


@dataclass(frozen=True)
class ListHands(Answering):
    """List the known hands."""

    def run(self) -> CommandResult:
        from fungrasp.hands import hand_files, load_hand
        from fungrasp.hands.hand_description import hand_mass

        rows = []
        for name in hand_files():
            hand = load_hand(name)
            rows.append(
                {
                    "name": name,
                    "title": hand.title,
                    "fingers": list(hand.fingers),
                    "independent_joints": len(hand.actuators),
                    "joints": len(hand.joint_names),
                    "mass": round(hand_mass(hand), 4),
                }
            )
        lines = [("name", "fingers", "driven/all joints", "mass [kg]", "title")]
        for row in rows:
            joints = f"{row['independent_joints']}/{row['joints']}"
            lines.append((row["name"], str(len(row["fingers"])), joints, f"{row['mass']:.2f}", row["title"]))
        return CommandResult(rows, table(lines, left=None))


@dataclass(frozen=True)
class ShowHand(Answering):
    """Show a hand: fingers, joint limits, couplings, actuators."""

    name: HandName
    """Name of a hand, or the path of its TOML file or folder."""
    picture: Path | None = None
    """Draw the hand from four sides to this file (.png or .jpg)."""

    def run(self) -> CommandResult:
        from fungrasp.hands import load_hand
        from fungrasp.hands.hand_description import describe_hand

        hand = load_hand(self.name)
        description = describe_hand(hand)
        if self.picture is not None:
            from fungrasp.media.pictures import draw_hand

            draw_hand(self.picture, hand)
            print(f"wrote {self.picture}", file=sys.stderr)
        return CommandResult(description, _text(description))


@dataclass(frozen=True)
class CheckHand(Answering):
    """Check a hand's files. Exit status 1: the hand cannot be used."""

    path: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PATH")]
    """Name of a hand, the path of its TOML file or folder, or a URDF or MJCF file."""

    def run(self) -> CommandResult:
        from fungrasp.hands import hand_files
        from fungrasp.hands.adding.add_hand import check_hand_files

        findings = check_hand_files(hand_files().get(self.path, Path(self.path)))
        rows, text, status = _findings(self.path, findings)
        return CommandResult(rows, text, status=status)


@dataclass(frozen=True)
class AddHand(Answering):
    """Make a hand folder from any URDF or MJCF: a model and a TOML file, ready for --hand.

    Palm, fingers, thumb, tips and side are detected from the bodies and the geometry. If one of them cannot
    be detected, the error names its option.
    """

    path: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """A URDF or MJCF file; meshes are also searched for in nearby folders."""
    out: Path | None = None
    """Folder to write. Default: the hand's name."""
    name: str | None = None
    """Name of the hand. Default: the file's name."""
    palm: str | None = None
    """The body that carries the fingers; bodies before it are removed."""
    thumb: str | None = None
    """A body of the thumb."""
    finger: tuple[str, ...] = ()
    """Fingers by one of their bodies: index=BODY middle=BODY ...; other fingers are ignored."""
    side: Literal["right", "left"] | None = None
    """Corresponding human hand."""
    normal: tuple[float, float, float] | None = None
    """Direction from the palm to a held object, in the frame of the palm body."""
    couple: tuple[str, ...] = ()
    """Coupled joints: JOINT=SLOPE*DRIVER or JOINT=OFFSET+SLOPE*DRIVER, angles in radians."""
    radius: float | None = None
    """Radius of fingers without geometry [m]."""
    force: bool = False
    """Overwrite existing files."""

    def run(self) -> CommandResult:
        from fungrasp.hands import load_hand
        from fungrasp.hands.adding.add_hand import Answers, add_hand, parse_couplings, parse_fingers

        fingers, couplings = parse_fingers(self.finger), parse_couplings(self.couple)
        answers = Answers(self.palm, self.thumb, self.side, self.normal, fingers, couplings, self.radius)
        path, findings = add_hand(self.path, self.out, self.name, answers, self.force)
        rows, text, status = _findings(path, findings)
        if not status:
            mirror = "--mirror" if load_hand(path).side == "left" else ""
            grasps = option("--out", f"{path.parent.name}.npz")
            text = f"{text}\n{suggestion('retarget', mirror, option('--hand', path), grasps)}"
        return CommandResult({"hand": path, "findings": rows}, text, status=status)


@dataclass(frozen=True)
class ExportHand(Answering):
    """Write a hand as a single self-contained MJCF file with position actuators."""

    name: HandName
    """Name of a hand, or the path of its TOML file or folder."""
    out: Path
    """File to write, for example allegro.xml."""
    arm: str | None = None
    """Mount the hand on this arm: ur5e."""

    def run(self) -> CommandResult:
        from fungrasp.core.files import atomic_path
        from fungrasp.hands import load_hand
        from fungrasp.hands.arm import export_hand

        text = export_hand(load_hand(self.name), self.arm)
        with atomic_path(self.out) as temporary:
            temporary.write_text(text)
        return CommandResult({"hand": self.out}, f"wrote {self.out}")


COMMAND = {"list": ListHands, "show": ShowHand, "add": AddHand, "check": CheckHand, "export": ExportHand}


def _text(hand: dict[str, Any]) -> str:
    lines = [
        f"{hand['name']}: {hand['title']}",
        f"  model  {hand['model']}",
        f"  mass   {hand['mass']:.3f} kg",
        f"  palm   {hand['palm']}; fingers along {_vector(hand['palm_frame']['fingers'])}, "
        f"palm faces {_vector(hand['palm_frame']['normal'])}",
        "",
        "fingers (links from base to tip; contact points at their far ends)",
    ]
    fingers = [
        (f"  {name}", " > ".join((*finger["links"], finger["tip"])), ", ".join(finger["contact_points"]))
        for name, finger in hand["fingers"].items()
    ]
    servos = {actuator["joint"]: actuator for actuator in hand["actuators"]}
    couplings = {coupling["joint"]: coupling for coupling in hand["couplings"]}
    joints = [("  joint", "body", "limits [rad]", "driven by")]
    for joint in hand["joints"]:
        name, limits = joint["name"], joint["limits"]
        if name in servos:
            servo = servos[name]
            drive = f"servo kp {servo['kp']:g}, kd {servo['kd']:g}, up to {servo['force_limit']:g} N m"
        elif name in couplings:
            coupling = couplings[name]
            drive = f"{coupling['constant']:g} + {coupling['slope']:g} * {coupling['driver']}"
        else:
            drive = ""
        joints.append(
            (f"  {name}", joint["body"], f"{limits[0]:.3f} to {limits[1]:.3f}" if limits else "none", drive)
        )
    return "\n".join([*lines, table(fingers, left=None), "", "joints", table(joints, left=None)])


def _vector(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in values) + ")"


def _findings(path: str | Path, findings: Sequence[Finding]) -> tuple[list[dict[str, str]], str, int]:
    """Return findings as rows and as text, and the exit status: 1 for errors."""
    rows = [{"severity": finding.severity, "message": finding.message} for finding in findings]
    errors, warnings = (sum(row["severity"] == severity for row in rows) for severity in ("error", "warning"))
    lines = [f"{row['severity']}: {row['message']}" for row in rows]
    lines.append(f"{path}: {_count(errors, 'error')}, {_count(warnings, 'warning')}")
    return rows, "\n".join(lines), int(errors > 0)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"
