"""Where the parts of a hand are: along a link, about a joint, on the palm."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from fungrasp.hands import Hand
from fungrasp.media.hand_shells.shapes import Solid

Finish = tuple[tuple[float, float, float], float, float]
"""Color (sRGB), strength and narrowness of the highlight, both from 0 to 1."""


@dataclass(frozen=True)
class Shell:
    """A part of a hand for the eye."""

    body: str
    """Body that carries it."""
    solid: Solid
    """Frame of that body."""
    look: Finish
    """Of its surface."""


@dataclass(frozen=True)
class LinkFrame:
    """The frame of a capsule of a finger: z from its near to its far end, x along the axis about which the
    finger bends, y to the side that touches."""

    body: str
    """That carries it."""
    origin: np.ndarray
    """Center of its near end, body frame [m], shape [3]."""
    axes: np.ndarray
    """Columns x, y, z, body frame, shape [3, 3]."""
    length: float
    """Between the centers of its ends [m]."""
    radius: float
    """[m]"""

    def shell(self, solid: Solid, look: Finish) -> Shell:
        """A part that is described in this frame."""
        return Shell(self.body, solid.moved(self.axes, self.origin), look)


class HandFrames:
    """Frames of a hand's parts, by the names of its collision shapes."""

    def __init__(self, hand: Hand):
        self.hand, self.model = hand, hand.model
        self._data = mujoco.MjData(hand.model)
        mujoco.mj_kinematics(self.model, self._data)

    def geoms(self, start: str = "") -> list[str]:
        """Names of collision shapes that begin with some letters."""
        names = [self.model.geom(i).name for i in range(self.model.ngeom)]
        return [name for name in names if name.startswith(start)]

    def link(self, geom: str) -> LinkFrame:
        """The frame of a capsule."""
        model, data = self.model, self._data
        i = model.geom(geom).id
        body = int(model.geom_bodyid[i])
        turn = data.xmat[body].reshape(3, 3)
        place, own = data.geom_xpos[i], data.geom_xmat[i].reshape(3, 3)
        half, radius = float(model.geom_size[i, 1]), float(model.geom_size[i, 0])
        along = own[:, 2]
        anchor, axis = self._bending(body, along)
        # The near end is the one that the joint is nearer to.
        if float(np.linalg.norm(place + half * along - anchor)) < float(
            np.linalg.norm(place - half * along - anchor)
        ):
            along = -along
        touching = np.cross(axis, along)
        touching /= np.linalg.norm(touching)
        axes = np.stack([np.cross(touching, along), touching, along], axis=-1)
        origin = turn.T @ (place - half * along - data.xpos[body])
        return LinkFrame(model.body(body).name, origin, turn.T @ axes, 2 * half, radius)

    def box(self, geom: str) -> tuple[str, np.ndarray, np.ndarray, np.ndarray]:
        """Body, center [m], axes and half sides [m] of a box, body frame."""
        model = self.model
        i = model.geom(geom).id
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[i])
        name = model.body(int(model.geom_bodyid[i])).name
        return name, model.geom_pos[i].copy(), rotation.reshape(3, 3), model.geom_size[i].copy()

    def palm_axes(self) -> np.ndarray:
        """Columns: across the palm to the index finger, to the fingers, out of the palm; palm frame."""
        hand = self.hand
        return np.stack([hand.index_side, hand.palm_fingers, hand.palm_normal], axis=-1)

    def on_palm(self, solid: Solid, look: Finish) -> Shell:
        """A part that is described by ``palm_axes``."""
        axes = self.palm_axes()
        if np.linalg.det(axes) < 0:
            solid = Solid(solid.vertices, solid.faces[:, ::-1])
        return Shell(self.hand.palm, solid.moved(axes, np.zeros(3)), look)

    def _bending(self, body: int, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Place and axis, world frame, of the nearest joint towards the palm that bends a link."""
        model, data = self.model, self._data
        while body > 0:
            first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
            for joint in range(first + count - 1, first - 1, -1):
                turn = data.xmat[body].reshape(3, 3)
                axis = turn @ model.jnt_axis[joint]
                if abs(float(axis @ along)) < 0.7:
                    low, high = model.jnt_range[joint]
                    sign = 1.0 if high >= -low else -1.0
                    return data.xpos[body] + turn @ model.jnt_pos[joint], sign * axis
            body = int(model.body_parentid[body])
        return np.zeros(3), np.array([1.0, 0.0, 0.0])
