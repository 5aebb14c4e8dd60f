"""The hand and arm of a test capture: skin with knuckles, creases, nails, and a sleeve. For pictures only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from benchmarks.synthetic_captures.painted_mesh import PaintedMesh, mixed
from fungrasp.grasps import HUMAN_JOINTS
from fungrasp.media.hand_mesh import FINGER_RADII, LINK_JOINTS, REFERENCE_PALM, THUMB_RADII, human_hand_mesh
from fungrasp.media.surfaces import Color

SKIN_TONES: tuple[Color, ...] = (
    (0.92, 0.76, 0.67),
    (0.88, 0.70, 0.58),
    (0.80, 0.61, 0.48),
    (0.69, 0.50, 0.38),
    (0.52, 0.36, 0.26),
    (0.36, 0.25, 0.19),
)
"""Skin on the back of a hand, sRGB, light to dark."""

CELL = 0.0018
"""Grid on which the skin is found [m]."""

FOREARM = 0.45
"""Length of the arm behind the wrist [m]: so long that its end is seldom in the image."""

CLEARANCE = 0.05
"""The axis of the arm keeps at least this height above the table [m]."""

_STUMP = (0.012, 0.045)
"""Where the forearm of ``human_hand_mesh`` begins and ends behind the wrist [m], at its reference size."""

WRIST_HALF = (0.0295, 0.0185)
"""Half the width and half the thickness of the wrist [m], at the reference size."""

_WRIST, _INDEX, _MIDDLE, _RING, _PINKY, _THUMB_MCP = (
    HUMAN_JOINTS.index(name)
    for name in ("wrist", "index_mcp", "middle_mcp", "ring_mcp", "pinky_mcp", "thumb_mcp")
)


@dataclass(frozen=True)
class Forearm:
    """The forearm: a tube of elliptic section along a quadratic Bezier curve from the wrist to the elbow."""

    control: np.ndarray
    """Control points of the curve [m], world frame, shape [3, 3]."""
    across: np.ndarray
    """Direction across the wrist, from the little finger's side to the thumb's, shape [3]."""
    slow: float
    """Part of the curve that the hand mesh's own stump covered."""
    scale: float
    """Size of the hand compared with the reference."""

    def frame(self, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points of the middle line [m], shape [..., 3], and axes: side, over, along, shape [..., 3, 3].

        part: 0 at the wrist to 1 at the elbow, as the stump is stretched, shape [...].
        """
        a, b, c = self.control
        t = (self.slow * part + (1 - self.slow) * part**2)[..., None]
        point = (1 - t) ** 2 * a + 2 * t * (1 - t) * b + t**2 * c
        along = 2 * (1 - t) * (b - a) + 2 * t * (c - b)
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        side = self.across - along * (along @ self.across)[..., None]
        side /= np.linalg.norm(side, axis=-1, keepdims=True)
        return point, np.stack([side, np.cross(along, side), along], axis=-2)

    def growth(self, part: np.ndarray) -> np.ndarray:
        """How much wider and thicker the arm is than the wrist, shape [..., 2]."""
        wide = 1.0 + 0.5 * part**2
        return np.stack([wide, wide * (1 + 0.3 * part**2)], axis=-1)


def painted_hand(joints: np.ndarray, tone: Color, rng: np.random.Generator) -> tuple[PaintedMesh, Forearm]:
    """The skin of a right hand with its forearm, which bends away from the table.

    Args:
        joints: [m], world frame, shape [21, 3].
        tone: of the skin, sRGB.
        rng: decides the blotches of the skin.
    """
    joints = np.asarray(joints, dtype=float)
    hand = human_hand_mesh(joints, cell=CELL)
    scale = float(np.linalg.norm(joints[_MIDDLE] - joints[_WRIST])) / REFERENCE_PALM
    mesh = trimesh.Trimesh(hand.vertices, hand.faces, process=False)
    normals = np.array(mesh.vertex_normals)
    marks = _marks(joints, hand.vertices, normals, hand.links, scale)
    red = np.clip(marks.red + 0.10 * blotches(hand.vertices, rng), 0, 1)
    skin = np.asarray(tone)
    flushed = skin * [0.93, 0.68, 0.62]
    light = 1.0 - (1.0 - skin) * [0.62, 0.70, 0.72]
    colors = mixed(skin, flushed, red)
    colors = mixed(colors, light, np.clip(marks.pale, 0, 1))
    vertices, arm = _with_forearm(joints, hand.vertices + marks.swell[:, None] * normals, scale)
    return PaintedMesh(vertices, hand.faces, colors), arm


def painted_sleeve(arm: Forearm, start: float, color: Color, rng: np.random.Generator) -> PaintedMesh:
    """A sleeve round the forearm, with a hem.

    Args:
        arm: the forearm.
        start: where the sleeve begins, 0 at the wrist to 1 at the elbow.
        color: of the cloth, sRGB.
        rng: decides the folds.
    """
    rings, around = 64, 64
    part = np.concatenate([[start + 0.01], np.linspace(start, 1.0, rings - 1)])
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    point, axes = arm.frame(part)
    phase, turns = rng.uniform(0, 2 * np.pi, 4), rng.integers(0, 4, 4)
    waves = [np.sin(turns[k] * angle + (14 + 11 * k) * part[:, None] + phase[k]) for k in range(4)]
    folds = np.sum(waves, axis=0) / 4
    half = arm.scale * np.array(WRIST_HALF) * arm.growth(part) + 0.007 + 0.012 * (part - start)[:, None]
    half[0] -= 0.005
    half = half[:, None] + 0.003 * folds[..., None] * (part > start + 0.02)[:, None, None]
    rim = half * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    # Rings r, angles a: the section's two coordinates j along the rows of axes [rings, 3, 3].
    vertices = (point[:, None] + np.einsum("raj,rji->rai", rim, axes[:, :2])).reshape(-1, 3)
    row, column = np.mgrid[: rings - 1, :around]
    a, b = row * around + column, row * around + (column + 1) % around
    quads = np.stack([a, b, b + around, a + around], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    shade = 1.0 + 0.10 * folds.reshape(-1, 1)
    return PaintedMesh(vertices, faces, np.clip(np.asarray(color) * shade, 0.0, 1.0))


def _with_forearm(joints: np.ndarray, vertices: np.ndarray, scale: float) -> tuple[np.ndarray, Forearm]:
    """Stretch the stump behind the wrist into an arm along a curve that stays above the table."""
    wrist = joints[_WRIST]
    back = _unit(wrist - joints[[_MIDDLE, _RING]].mean(0))
    across = joints[_INDEX] - joints[_PINKY]
    across = _unit(across - back * (across @ back))
    start, end = (scale * s for s in _STUMP)
    length = FOREARM * scale
    first, bend = wrist + start * back, wrist + (start + 0.5 * length) * back
    bend[2] = max(bend[2], CLEARANCE)
    onward = back.copy()
    onward[2] = max(onward[2], (CLEARANCE + 0.02 - bend[2]) / (0.5 * length), -0.2)
    control = np.stack([first, bend, bend + 0.5 * length * _unit(onward)])
    arm = Forearm(control, across, (end - start) / length, scale)
    local = vertices - first
    moves = local @ back > 0
    local, behind = local[moves], local[moves] @ back
    part = np.clip(behind / (end - start), 0.0, 1.0)
    point, axes = arm.frame(part)
    section = np.stack([local @ across, local @ np.cross(back, across)], axis=-1) * arm.growth(part)
    onward = (behind - part * (end - start))[:, None]
    vertices = vertices.copy()
    vertices[moves] = point + np.einsum("vj,vji->vi", np.concatenate([section, onward], axis=-1), axes)
    return vertices, arm


@dataclass(frozen=True)
class _Marks:
    """What the skin shows, per vertex, filled in place."""

    red: np.ndarray
    """Redness of the skin, 0 to 1."""
    pale: np.ndarray
    """Paleness of the skin, 0 to 1."""
    swell: np.ndarray
    """Height above the smooth skin [m]."""


def _marks(
    joints: np.ndarray, vertices: np.ndarray, normals: np.ndarray, links: np.ndarray, scale: float
) -> _Marks:
    marks = _Marks(*(np.zeros(len(vertices)) for _ in range(3)))
    dorsal = _dorsal(joints)
    for finger in range(5):
        for k in range(3):
            link = 1 + 3 * finger + k
            near, far = (joints[j] for j in LINK_JOINTS[link])
            length = float(np.linalg.norm(far - near))
            along, up = (far - near) / length, dorsal[finger, k]
            family = [link - 1 if k else 0, link, *([link + 1] if k < 2 else [])]
            rows = np.flatnonzero(links[:, family].sum(1) > 0.3)
            offset = vertices[rows] - near
            place, aside = offset @ along, offset @ np.cross(along, up)
            height = normals[rows] @ up
            if k or finger < 4:
                knuckle = np.exp(-((place**2 + 0.4 * aside**2) / (0.0055 * scale) ** 2)) * np.clip(
                    height, 0, 1
                )
                marks.red[rows] += 0.30 * knuckle
                marks.swell[rows] += 0.0007 * scale * knuckle
            if k:
                crease = np.exp(-((place / (0.0011 * scale)) ** 2))
                marks.red[rows] += 0.5 * crease * np.clip(0.3 - height, 0, 1)
                marks.swell[rows] -= 0.0005 * scale * crease * np.clip(-height, 0, 1)
            if k == 2:
                radius = (THUMB_RADII if finger == 4 else FINGER_RADII)[-1] * scale
                _mark_fingertip(marks, rows, place / length, aside / radius, height, scale)
    marks.pale[:] += 0.22 * links[:, 0] * np.clip(normals @ -dorsal[1, 0], 0, 1)
    return marks


def _mark_fingertip(
    marks: _Marks, rows: np.ndarray, part: np.ndarray, aside: np.ndarray, height: np.ndarray, scale: float
) -> None:
    """Nail, redder end and pad of one finger.

    Args:
        marks: to be added to.
        rows: vertices of the finger's end, length R.
        part: of the way along the last link, shape [R].
        aside: place across the finger, as a part of its radius, shape [R].
        height: cosine of the angle between the skin's normal and the back of the finger, shape [R].
        scale: size of the hand compared with the reference.
    """
    red, pale, swell = marks.red, marks.pale, marks.swell
    red[rows] += 0.28 * np.clip((part - 0.35) / 0.5, 0, 1) * np.clip(0.6 - height, 0, 1)
    swell[rows] += 0.0008 * scale * np.exp(-(((part - 0.55) / 0.25) ** 2)) * np.clip(-height, 0, 1)
    edge = ((part - 0.70) / 0.27) ** 4 + (aside / 0.80) ** 4
    nail = np.clip(1.6 - 1.2 * edge, 0, 1) * (height > 0.1)
    rim = np.exp(-(((edge - 1.15) / 0.35) ** 2)) * (height > 0.1)
    red[rows] = red[rows] * (1 - nail) + 0.20 * nail + 0.45 * rim
    pale[rows] = np.maximum(pale[rows], 0.75 * nail + 0.2 * nail * (part > 0.88))
    swell[rows] += scale * (0.0003 * nail - 0.0004 * rim)


def _dorsal(joints: np.ndarray) -> np.ndarray:
    """Unit vector out of the back of each finger link, shape [5, 3, 3]."""
    result = np.empty((5, 3, 3))
    across = joints[_INDEX] - joints[_PINKY]
    for finger in range(5):
        chain = joints[1 + 4 * finger : 5 + 4 * finger]
        for k in range(3):
            along = _unit(chain[k + 1] - chain[k])
            if finger < 4:
                up = np.cross(along, across)
            else:
                facing = joints[[3, 7]].mean(0) - joints[_THUMB_MCP]
                curl = chain[2] - 0.5 * (chain[1] + chain[3])
                up = 4.0 * curl - _unit(facing - along * (facing @ along)) * 0.02
            result[finger, k] = _unit(up - along * (up @ along))
    return result


def blotches(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Smooth random pattern, about 0 to 1, shape [V]."""
    total = np.zeros(len(points))
    for size in (0.03, 0.015, 0.007):
        waves = rng.normal(size=(3, 3)) * (2 * np.pi / size) / 1.7
        total += np.prod(np.sin(points @ waves.T + rng.uniform(0, 2 * np.pi, 3)), axis=1)
    return 0.5 + 0.5 * total


def _unit(vector: np.ndarray | Sequence[float]) -> np.ndarray:
    vector = np.asarray(vector, dtype=float)
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
