"""Reference models of real hands, from which the tests read frames, limits, masses and couplings.

The files are the makers' URDF or MJCF texts without their meshes; they are not part of this project, and
where they are missing the tests against them are skipped. To cover one more hand, add it to ``REFERENCES``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import mujoco

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
    """Those frames lie this far beyond our sites along z [m]: at a round tip's end, not its centre."""
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


def reference_model(reference: Reference) -> mujoco.MjModel:
    """The reference's kinematics: no shapes, no actuators, placeholder masses."""
    root = _read(FOLDER / reference.file)
    urdf = root.tag == "robot"
    for parent in list(root.iter()):
        parent.text = parent.tail = None
        for child in list(parent):
            if child.tag in _DROPPED:
                parent.remove(child)
    if urdf:
        extension = ElementTree.SubElement(root, "mujoco")
        ElementTree.SubElement(extension, "compiler", angle="radian", fusestatic="false")
        for link in root.iter("link"):
            inertial = ElementTree.SubElement(link, "inertial")
            ElementTree.SubElement(inertial, "mass", value="1")
            ElementTree.SubElement(inertial, "inertia", ixx="1", iyy="1", izz="1", ixy="0", ixz="0", iyz="0")
    else:
        for body in root.iter("body"):
            ElementTree.SubElement(body, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


def reference_masses(reference: Reference) -> dict[str, float]:
    """Mass of each body that has one in the file [kg]."""
    root = _read(FOLDER / reference.file)
    if root.tag == "robot":
        inertials = ((link.get("name", ""), link.find("inertial/mass")) for link in root.iter("link"))
        return {name: float(mass.get("value", "nan")) for name, mass in inertials if mass is not None}
    inertials = ((body.get("name", ""), body.find("inertial")) for body in root.iter("body"))
    return {name: float(inertial.get("mass", "nan")) for name, inertial in inertials if inertial is not None}


def reference_couplings(reference: Reference) -> list[tuple[dict[str, float], float]]:
    """Linear equations between joint angles: coefficients by their joint name, and the sum [rad]."""
    root = _read(FOLDER / reference.file)
    equations = []
    for joint in root.iter("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            factor, offset = float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
            equations.append(({joint.get("name", ""): 1.0, mimic.get("joint", ""): -factor}, offset))
    if root.find("default/tendon[@limited='true']") is not None:
        for tendon in root.iter("fixed"):
            terms = {j.get("joint", ""): float(j.get("coef", "nan")) for j in tendon.iter("joint")}
            equations.append((terms, 0.0))
    return equations


_DROPPED = frozenset(
    {"asset", "geom", "mesh", "visual", "collision", "inertial", "site"}
    | {"option", "contact", "tendon", "sensor", "actuator"}
)


def _read(path: Path) -> ElementTree.Element:
    """The XML file with what it includes put in place."""
    root = ElementTree.parse(path).getroot()
    for parent in list(root.iter()):
        for include in parent.findall("include"):
            at = list(parent).index(include)
            parent[at : at + 1] = _read(path.parent / include.get("file", ""))
    return root
