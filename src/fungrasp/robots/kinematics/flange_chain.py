"""Where an arm's flange is, from six numbers alone: for the processes of drivers, which need no engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.geometry.poses import compose

if TYPE_CHECKING:
    import mujoco


@dataclass(frozen=True, eq=False)
class FlangeChain:
    """Joints one after the other, each of which turns about its own z axis."""

    links: np.ndarray
    """Pose of each joint in the frame of the one before, the first in the base, at zero; the last row is the
    flange in the last joint; shape [M + 1, 7]."""

    def flange_pose(self, joints: np.ndarray) -> np.ndarray:
        """Pose of the flange in the base, shape [7]. joints: [rad], shape [M]."""
        pose = self.links[0]
        for angle, link in zip(joints, self.links[1:], strict=True):
            turn = np.array([0.0, 0.0, 0.0, np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)])
            pose = compose(compose(pose, turn), link)
        return pose


def flange_chain(arm: str) -> FlangeChain:
    """The chain of an arm.

    Args:
        arm: name or file of its model.

    Raises:
        FungraspError: no such arm, or no model of one.
    """
    # Here: the processes of drivers get a chain that is made already.
    from fungrasp.hands.arm import arm_spec

    return chain_of_model(arm_spec(arm))


def chain_of_model(spec: mujoco.MjSpec) -> FlangeChain:
    """The chain of an arm's model, whose joints turn about z."""
    from fungrasp.hands.arm import FLANGE_SITE

    model = spec.compile()
    site = model.site(FLANGE_SITE)
    body, link = int(site.bodyid[0]), np.concatenate([site.pos, site.quat])
    links: list[np.ndarray] = []
    while body:
        if model.body_jntnum[body]:
            assert np.allclose(model.jnt_axis[model.body_jntadr[body]], [0, 0, 1])
            links.append(link)
            link = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        link = compose(np.concatenate([model.body_pos[body], model.body_quat[body]]), link)
        body = int(model.body_parentid[body])
    return FlangeChain(np.array([*links, link][::-1]))
