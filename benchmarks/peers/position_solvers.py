"""dex-retargeting and its port dexi-rs: fingertips and middle joints to the human's, by the published
"position" configuration with a free wrist. They know neither object nor table."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.peers.problem import HUMAN_ORDER, CpuClock, PeerProblem
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand
from fungrasp.hands.export import model_urdf

CALLS = 5
"""Calls for each grasp, each from the last one's result, as in a video that stands still; more change
nothing."""

HUMAN_TIPS, HUMAN_MIDDLES = (
    {"thumb": 4, "index": 8, "middle": 12, "ring": 16, "pinky": 20},
    {"thumb": 2, "index": 6, "middle": 10, "ring": 14, "pinky": 18},
)
"""Joints in the order of MANO."""

DUMMIES = [f"dummy_{axis}_{kind}_joint" for kind in ("translation", "rotation") for axis in "xyz"]
"""Joints of the free wrist: position, then rotations about the moving axes x, y, z."""


def solve_dex_retargeting(problem: PeerProblem) -> tuple[RobotGraspSet, float]:
    """By dex-retargeting (Qin et al., "AnyTeleop", 2023). Returns the grasps and processor seconds."""
    from dex_retargeting.retargeting_config import RetargetingConfig  # pyright: ignore[reportMissingImports]

    with HandUrdf(problem.hand) as path:
        config = RetargetingConfig.from_dict(position_configuration(problem.hand), {"urdf_path": path})
        config.target_joint_names = list(problem.hand.actuators)
        solver = config.build()
    joints = _human(problem)
    indices = solver.optimizer.target_link_human_indices
    turn = problem.wrist_start[:, 3:]

    def one(row: int) -> np.ndarray:
        solver.reset()
        solver.warm_start(joints[row, 0], turn[row])
        for _ in range(CALLS):
            found = solver.retarget(joints[row, indices])
        return np.array(found)

    one(0)
    with CpuClock() as clock:
        found = np.array([one(row) for row in range(len(joints))])
    return _grasps(problem, found, list(solver.optimizer.robot.dof_joint_names)), clock.seconds


def solve_dexi(problem: PeerProblem) -> tuple[RobotGraspSet, float]:
    """By dexi-rs, the same in Rust. Returns the grasps and processor seconds."""
    import dexi_rs  # pyright: ignore[reportMissingImports]

    configuration: dict[str, Any] = position_configuration(problem.hand) | {
        "target_joint_names": list(problem.hand.actuators)
    }
    with HandUrdf(problem.hand) as path:
        solver = dexi_rs.RetargetingConfig(urdf_path=path, **configuration).build()
    names, joints = list(solver.joint_names), _human(problem)
    start = np.zeros((len(joints), len(names)))
    half = 0.5 * (problem.points.kinematics.lower + problem.points.kinematics.upper)
    start[:, [names.index(name) for name in problem.hand.joint_names]] = problem.hand.all_joints(half)
    turn = Rotation.from_quat(problem.wrist_start[:, 3:], scalar_first=True)
    start[:, [names.index(name) for name in DUMMIES]] = np.c_[joints[:, 0], turn.as_euler("XYZ")]
    reference = joints[:, configuration["target_link_human_indices"]].reshape(len(joints), -1).tolist()
    given = start.tolist()

    def one(row: int) -> list[float]:
        solver.reset()
        solver.set_qpos(given[row])
        for _ in range(CALLS):
            found = solver.retarget(reference[row])
        return found

    one(0)
    with CpuClock() as clock:
        found = np.array([one(row) for row in range(len(joints))])
    return _grasps(problem, found, names), clock.seconds


def human_indices(hand: Hand) -> list[int]:
    """Human joints that a hand's fingertips and middle joints go to, in the order of MANO."""
    fingers = hand.fingers
    names = [name for name in HUMAN_TIPS if name in fingers]
    middles = [name for name in names if len(fingers[name].joints) > 1]
    return [HUMAN_TIPS[n] for n in names] + [HUMAN_MIDDLES[n] for n in middles]


def position_configuration(hand: Hand) -> dict[str, Any]:
    """As published; the scale of 1.6 for gestures in the air is 1 here, and nothing is smoothed over time."""
    fingers = hand.fingers
    names = [name for name in HUMAN_TIPS if name in fingers]
    middles = [fingers[name].joints[1] for name in names if len(fingers[name].joints) > 1]
    return {
        "type": "position",
        "target_joint_names": None,
        "target_link_names": [*(fingers[name].tip for name in names), *middles],
        "target_link_human_indices": human_indices(hand),
        "add_dummy_free_joint": True,
        "low_pass_alpha": 1.0,
    }


def _human(problem: PeerProblem) -> np.ndarray:
    return problem.human.hand_joints[:, HUMAN_ORDER].astype(float)


def _grasps(problem: PeerProblem, found: np.ndarray, names: list[str]) -> RobotGraspSet:
    free = found[:, [names.index(name) for name in DUMMIES]]
    turn = Rotation.from_euler("XYZ", free[:, 3:]).as_quat(scalar_first=True)
    joints = found[:, [names.index(name) for name in problem.hand.joint_names]]
    return problem.solved(np.concatenate([free[:, :3], turn], axis=1), joints)


def hand_urdf(hand: Hand) -> str:
    """A hand's kinematics and key points as URDF."""
    sites = [hand.model.site(number).name for number in range(hand.model.nsite)]
    frames = {name: name for name in sites if name in hand.keypoint_names}
    return ElementTree.tostring(model_urdf(hand.name, hand.model, None, frames=frames), encoding="unicode")


class HandUrdf:
    """The hand's URDF as a file, for as long as it is read."""

    def __init__(self, hand: Hand):
        self._text = hand_urdf(hand)
        self._folder = tempfile.TemporaryDirectory()

    def __enter__(self) -> str:
        path = Path(self._folder.name) / "hand.urdf"
        path.write_text(self._text)
        return str(path)

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()
