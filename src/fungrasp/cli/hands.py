"""``fungrasp hands``: list, show, add, check and export robot hands."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from fungrasp.cli.console import table
from fungrasp.errors import FungraspError

if TYPE_CHECKING:
    import mujoco

    from fungrasp.hands import Hand

HandName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]


@dataclass(frozen=True)
class ListHands:
    """List the known hands."""

    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> None:
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
        if self.json:
            print(json.dumps(rows, indent=2))
            return
        header = ("name", "fingers", "driven/all joints", "mass [kg]", "title")
        print(
            table(
                [
                    header,
                    *(
                        (
                            row["name"],
                            str(len(row["fingers"])),
                            f"{row['independent_joints']}/{row['joints']}",
                            f"{row['mass']:.2f}",
                            row["title"],
                        )
                        for row in rows
                    ),
                ],
                left=None,
            )
        )


@dataclass(frozen=True)
class ShowHand:
    """Show a hand: fingers, joints with limits, couplings, actuators."""

    name: HandName
    """A known hand, or the path of a hand's TOML file or folder."""
    json: bool = False
    """Print JSON and nothing else."""
    picture: Path | None = None
    """Also draw the hand from four sides into this file (.png, .jpg)."""

    def run(self) -> None:
        from fungrasp.hands import load_hand
        from fungrasp.hands.hand_description import describe_hand

        hand = load_hand(self.name)
        description = describe_hand(hand)
        if self.picture is not None:
            _draw(hand, self.picture)
        print(json.dumps(description, indent=2) if self.json else _text(description))


@dataclass(frozen=True)
class CheckHand:
    """Report what is wrong with a hand's files; exits with status 1 if the hand cannot be used as it is."""

    path: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="PATH")]
    """A hand's TOML file or folder, a URDF, an MJCF, or the name of a known hand."""
    json: bool = False
    """Print JSON and nothing else."""

    def run(self) -> None:
        from fungrasp.hands import hand_files
        from fungrasp.hands.checking.hand_checks import check_hand_files

        findings = check_hand_files(hand_files().get(self.path, Path(self.path)))
        errors = sum(finding.severity == "error" for finding in findings)
        if self.json:
            print(json.dumps([{"severity": f.severity, "message": f.message} for f in findings], indent=2))
        else:
            for finding in findings:
                print(f"{finding.severity}: {finding.message}")
            others = sum(finding.severity == "warning" for finding in findings)
            print(f"{self.path}: {_count(errors, 'error')}, {_count(others, 'warning')}")
        if errors:
            raise SystemExit(1)


@dataclass(frozen=True)
class AddHand:
    """Make a hand folder from any URDF or MJCF: one model and one TOML, ready for --hand.

    Palm, fingers, thumb, tips and side are found from the tree of bodies and the geometry. What can't be
    found is asked for by the name of an option.
    """

    path: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """A URDF or an MJCF; its meshes are looked for where it says and in folders nearby."""
    out: Path | None = None
    """The folder to write; named as the hand if not given."""
    name: str | None = None
    """Name of the hand; that of the file if not given."""
    palm: str | None = None
    """The body that carries the fingers; what lies before it is cut off."""
    thumb: str | None = None
    """A body of the thumb."""
    finger: tuple[str, ...] = ()
    """Which finger is which, by a body of it: index=BODY middle=BODY ...; those not named are left out."""
    side: Literal["right", "left"] | None = None
    """Which human hand it imitates."""
    normal: tuple[float, float, float] | None = None
    """Direction out of the palm towards a held object, in the frame of the palm body."""
    couple: tuple[str, ...] = ()
    """Joints that move together, as JOINT=SLOPE*DRIVER or JOINT=OFFSET+SLOPE*DRIVER, angles in radians."""
    radius: float | None = None
    """Of fingers whose shapes are missing [m]."""
    force: bool = False
    """Overwrite the hand in the folder."""

    def run(self) -> None:
        from fungrasp.hands import load_hand
        from fungrasp.hands.adding.add_hand import Answers, add_hand, parse_couplings, parse_fingers
        from fungrasp.hands.checking.hand_checks import check_hand_files

        fingers, couplings = parse_fingers(self.finger), parse_couplings(self.couple)
        answers = Answers(self.palm, self.thumb, self.side, self.normal, fingers, couplings, self.radius)
        path, findings = add_hand(self.path, self.out, self.name, answers, self.force)
        findings = [*findings, *check_hand_files(path)]
        errors = sum(finding.severity == "error" for finding in findings)
        warnings = sum(finding.severity == "warning" for finding in findings)
        for finding in findings:
            print(f"{finding.severity}: {finding.message}")
        print(f"{path}: {_count(errors, 'error')}, {_count(warnings, 'warning')}")
        if errors:
            raise SystemExit(1)
        mirror = "--mirror " if load_hand(path).side == "left" else ""
        grasps = f"{path.parent.name}.npz"
        print(f"next: fungrasp retarget {mirror}--hand {path} --out {grasps}")
        print(f"then: fungrasp evaluate --grasps {grasps} --hand {path}")


@dataclass(frozen=True)
class ExportHand:
    """Write a hand as one MJCF file that needs no other file, with position actuators."""

    name: HandName
    """A known hand, or the path of a hand's TOML file or folder."""
    out: Path
    """The file to write, for example allegro.xml."""
    arm: str | None = None
    """Mount the hand on this arm: ur5e."""

    def run(self) -> None:
        from fungrasp.files import atomic_path
        from fungrasp.hands import load_hand
        from fungrasp.hands.hand_export import export_hand

        text = export_hand(load_hand(self.name), self.arm)
        with atomic_path(self.out) as temporary:
            temporary.write_text(text)
        print(f"wrote {self.out}")


COMMAND = {"list": ListHands, "show": ShowHand, "add": AddHand, "check": CheckHand, "export": ExportHand}


def _draw(hand: Hand, path: Path) -> None:
    from PIL import Image

    from fungrasp.files import atomic_path
    from fungrasp.report.pictures import four_views, grid

    if path.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise FungraspError(f"a picture must be a .png or .jpg file, not {path}")
    picture = Image.fromarray(grid(four_views(_upright(hand)), columns=2))
    with atomic_path(path) as temporary:
        picture.save(temporary)
    print(f"wrote {path}", file=sys.stderr)


def _upright(hand: Hand) -> mujoco.MjModel:
    """The hand above the table, fingers up."""
    import mujoco

    from fungrasp.hands.arm import mounting_pose
    from fungrasp.rendering.hand_shells import dressed_spec

    pose = mounting_pose(hand)
    spec = mujoco.MjSpec()
    frame = spec.worldbody.add_frame(pos=pose[:3], quat=pose[3:])
    spec.attach(dressed_spec(hand), prefix="hand/", frame=frame)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    frame.pos[2] += max(0.0, (model.geom_rbound - data.geom_xpos[:, 2]).max())
    return spec.compile()


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


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"
