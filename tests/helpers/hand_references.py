"""What the makers' descriptions of real hands say: frames, joint axes, limits, masses and couplings.

The numbers are in ``hand_references.json``, computed once from the makers' URDF or MJCF texts, which are not
part of this project: each joint configuration's frames and axes by MuJoCo, the rest as the files have it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from fungrasp.geometry.poses import compose, invert, rotate
from fungrasp.hands import Hand

NUMBERS = Path(__file__).with_suffix(".json")
CONFIGURATIONS = 5
"""Joint configurations that frames and axes are compared in."""
FOLDER = Path(__file__).resolve().parents[2] / ".." / "shared" / "reference" / "hands"


@dataclass(frozen=True)
class Reference:
    """One file that describes a hand, and how its names map to ours."""

    file: str
    palm: str
    """The body whose frame is our palm's."""
    bodies: Mapping[str, str] = field(default_factory=dict)
    """Their name of each of our bodies that is called differently. A body that is neither here nor, under
    our name, in the file is not compared."""
    joints: Mapping[str, str] = field(default_factory=dict)
    """Their name of each of our joints that is called differently."""
    sites: Mapping[str, str] = field(default_factory=dict)
    """Their body (a fingertip frame) of each of our sites that has one."""
    sites_beyond: float = 0.0
    """Those frames lie this far beyond our sites along z [m]: at a round tip's end, not its center."""
    mass: float | None = None
    """Mass of the hand from the palm on [kg] where the file's masses don't tell it."""
    true_masses: bool = True
    """The masses in the file are the hand's."""


def _allegro_urdf_links() -> dict[str, str]:
    parts = ("base", "proximal", "medial", "distal")
    fingers = ("ff", "mf", "rf", "th")
    return {f"{f}_{p}": f"link_{4 * i + j}.0" for i, f in enumerate(fingers) for j, p in enumerate(parts)}


# Its lfmetacarpal and its thumb up to thmiddle are turned against the MJCF's, whose names and frames we have.
_SHADOW_URDF_BODIES = (
    "palm",
    *(f"{f}{p}" for f in ("ff", "mf", "rf", "lf") for p in ("knuckle", "proximal", "middle", "distal")),
    "thdistal",
)
_SHADOW_URDF_JOINTS = (
    *(f"{f}J{i}" for f in ("FF", "MF", "RF", "LF", "TH") for i in range(1, 5)),
    "LFJ5",
    "THJ5",
)
_FINGERS = ("index", "middle", "ring", "pinky", "thumb")

REFERENCES: Mapping[str, tuple[Reference, ...]] = {
    "allegro": (
        Reference("allegro_right.xml", "palm", true_masses=False),
        Reference(
            "allegro_right.urdf",
            "base_link",
            bodies={"palm": "base_link", **_allegro_urdf_links()},
            joints={
                f"{f}j{j}": f"joint_{4 * i + j}.0"
                for i, f in enumerate(("ff", "mf", "rf", "th"))
                for j in range(4)
            },
            sites={
                f"{f}_tip_centre": f"link_{4 * i + 3}.0_tip" for i, f in enumerate(("ff", "mf", "rf", "th"))
            },
            sites_beyond=0.012,
        ),
    ),
    "shadow": (
        Reference("shadow_right.xml", "rh_palm"),
        Reference(
            "shadow_right.urdf",
            "palm",
            bodies={f"rh_{name}": name for name in _SHADOW_URDF_BODIES},
            joints={f"rh_{name}": name for name in _SHADOW_URDF_JOINTS},
            sites={f"rh_{f}tip": f"{f}tip" for f in ("ff", "mf", "rf", "lf", "th")},
            true_masses=False,
        ),
    ),
    "faive": (
        Reference(
            "faive_hand.xml",
            "palm",
            sites={f"{f}_fingertip": f"{f}_fingertip" for f in _FINGERS},
            mass=0.106,  # said in faive_metadata.xml
            true_masses=False,
        ),
    ),
    "inspire": (
        Reference(
            "inspire_right.urdf",
            "hand_base_link",
            sites={f"{f}_tip": f"{f}_tip" for f in _FINGERS},
        ),
    ),
    "leap": (
        Reference(
            "leap_right.urdf",
            "palm_lower",
            sites={f"{f}_tip_head": f"{f}_tip_head" for f in ("index", "middle", "ring", "thumb")},
        ),
    ),
}
"""By hand name; the hand is compared with each."""


class Posed:
    """A model whose frames are read relative to its palm."""

    def __init__(self, model: mujoco.MjModel, palm: str):
        self.model, self.palm, self.data = model, palm, mujoco.MjData(model)

    def set(self, angles: dict[str, float]) -> None:
        """Joints not named stay at zero."""
        self.data.qpos[:] = 0.0
        for joint, angle in angles.items():
            self.data.qpos[self.model.joint(joint).qposadr[0]] = angle
        mujoco.mj_kinematics(self.model, self.data)

    def _pose_world(self, body: str) -> np.ndarray:
        frame = self.data.body(body)
        return np.concatenate([frame.xpos, frame.xquat])

    def body(self, name: str) -> np.ndarray:
        """Pose in the palm frame, shape [7]."""
        return compose(invert(self._pose_world(self.palm)), self._pose_world(name))

    def site(self, name: str) -> np.ndarray:
        """Pose in the palm frame, shape [7]."""
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, self.data.site(name).xmat)
        return compose(
            invert(self._pose_world(self.palm)), np.concatenate([self.data.site(name).xpos, quaternion])
        )

    def joint(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """A point on the axis and the axis' direction in the palm frame, shapes [3]."""
        inverse = invert(self._pose_world(self.palm))
        joint = self.data.joint(name)
        return inverse[:3] + rotate(inverse[3:], joint.xanchor), rotate(inverse[3:], joint.xaxis)

    def point(self, name: str) -> np.ndarray:
        """A site's, or else a body's, position in the palm frame, shape [3]."""
        is_site = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, name) >= 0
        return (self.site(name) if is_site else self.body(name))[:3]

    def capsule(self, geom: int) -> tuple[np.ndarray, np.ndarray]:
        """A capsule's middle and the direction of its axis in the palm frame, shapes [3]."""
        inverse = invert(self._pose_world(self.palm))
        axis = self.data.geom_xmat[geom].reshape(3, 3)[:, 2]
        return inverse[:3] + rotate(inverse[3:], self.data.geom_xpos[geom]), rotate(inverse[3:], axis)


def random_angles(hand: Hand, count: int) -> np.ndarray:
    """Joint angles [rad] that keep the couplings, shape [count, M]: limits, zero, then uniform draws."""
    free = [hand.joint_names.index(name) for name in hand.actuators]
    low, high = hand.joint_limits[free].T
    draws = np.random.default_rng(0).uniform(low, high, size=(count - 3, len(free)))
    matrix, offset = hand.coupling
    return np.concatenate([[low, high, np.clip(0.0, low, high)], draws]) @ matrix.T + offset


@dataclass(frozen=True)
class ReferenceNumbers:
    """What a reference says of a hand, by the reference's own names. Poses are relative to its palm."""

    sha256: str
    """Of the file that the numbers were computed from."""
    angles: dict[str, list[float]]
    """Joint angles [rad] of C configurations by joint, each shape [C]."""
    bodies: dict[str, np.ndarray]
    """Poses in these configurations by body, ``[x y z qw qx qy qz]``, shape [C, 7]."""
    axes: dict[str, np.ndarray]
    """A point on each joint's axis and the axis' direction, shape [C, 6]."""
    limits: dict[str, tuple[float, float]]
    """Joint limits [rad]."""
    masses: dict[str, float]
    """Masses by body [kg]."""
    couplings: list[tuple[dict[str, float], float]]
    """Linear equations between joint angles: coefficients by joint, and the sum [rad]."""


def reference_numbers(name: str, reference: Reference) -> ReferenceNumbers:
    """The kept numbers of a reference of the hand ``name``."""
    kept = json.loads(NUMBERS.read_text())[f"{name}/{reference.file}"]
    for key in ("bodies", "axes"):
        kept[key] = {body: np.array(values) for body, values in kept[key].items()}
    kept["couplings"] = [tuple(coupling) for coupling in kept["couplings"]]
    return ReferenceNumbers(**kept)
