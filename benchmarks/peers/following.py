"""``python -m benchmarks.peers.following``: a hand is followed frame by frame, by this package and by others.

The track goes through recorded hands, one after another: bones turn from each to the next and keep their
lengths, the palm rests between them, and each frame has the noise of a tracker. All methods get the same
noisy joints and a free wrist, and start each frame from the last one's result.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.command import main
from benchmarks.peers.comparison import PEERS, installed_peers
from benchmarks.peers.mink_solver import STEP_TIME, hand_on_free_joint
from benchmarks.peers.position_solvers import DUMMIES, HandUrdf, human_indices, position_configuration
from benchmarks.peers.problem import HUMAN_ORDER
from fungrasp.cli.console import table
from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.provenance import machine, run_record
from fungrasp.evaluation.result_files import write_result
from fungrasp.grasps import load_human_grasps
from fungrasp.grasps.human_hand import BONES
from fungrasp.hands import Hand, load_hand
from fungrasp.hands.collisions import self_collision_depth
from fungrasp.hands.kinematics import HandKinematics
from fungrasp.optimization.hand_state import HandPoints
from fungrasp.retargeting import Retargeter
from fungrasp.retargeting.contact_optimization import palm_alignment

Pose = tuple[np.ndarray, np.ndarray]
"""Palm, world frame, shape [7], and every joint [rad], shape [M]."""

Follow = Callable[[np.ndarray], Pose]
"""From one frame's joints [m], shape [21, 3], to the robot hand."""

STEPS = 5
"""Steps of mink's solver in each frame: more change the error by less than 0.1 mm."""


def moving_hand(hands: np.ndarray, frames: int, noise: float, rng: np.random.Generator) -> np.ndarray:
    """Joints of a hand that moves through recorded ones and rests at each.

    Args:
        hands: recorded joints [m], shape [H, 21, 3].
        frames: from one to the next.
        noise: standard deviation of each coordinate of each joint [m].
        rng: draws the noise.

    Returns:
        Shape [(H - 1) * frames, 21, 3]; wrists at the origin, palms turned alike.
    """
    local = np.array([_upright(joints) for joints in hands])
    shares = 0.5 - 0.5 * np.cos(np.pi * np.minimum(np.arange(frames) / (0.75 * frames), 1))
    track = np.zeros((len(hands) - 1, frames, 21, 3))
    for parent, child in BONES:
        bone = local[:, child] - local[:, parent]
        length = np.linalg.norm(bone, axis=-1).mean()
        a, b = (
            x[:, None] / np.linalg.norm(x[:, None], axis=-1, keepdims=True) for x in (bone[:-1], bone[1:])
        )
        turned = a + shares[:, None] * (b - a)
        turned *= length / np.linalg.norm(turned, axis=-1, keepdims=True)
        track[:, :, child] = track[:, :, parent] + turned
    track = track.reshape(-1, 21, 3)
    return track + noise * rng.normal(size=track.shape)


def _upright(joints: np.ndarray) -> np.ndarray:
    """Joints with the wrist at the origin, fingers along x and the index's side along y."""
    x = joints[5] - joints[0]
    x = x / np.linalg.norm(x)
    z = np.cross(x, joints[1] - joints[13])
    z = z / np.linalg.norm(z)
    return (joints - joints[0]) @ np.stack([x, np.cross(z, x), z], axis=-1)


def follow_fungrasp(hand: Hand) -> Follow:
    """By ``fungrasp.Retargeter``."""
    retargeter = Retargeter(hand)
    return retargeter.follow


def follow_dex_retargeting(hand: Hand) -> Follow:
    """By dex-retargeting (Qin et al., "AnyTeleop", 2023)."""
    from dex_retargeting.retargeting_config import RetargetingConfig  # pyright: ignore[reportMissingImports]

    with HandUrdf(hand) as path:
        config = RetargetingConfig.from_dict(position_configuration(hand), {"urdf_path": path})
        config.target_joint_names = list(hand.actuators)
        solver = config.build()
    names, indices = list(solver.optimizer.robot.dof_joint_names), solver.optimizer.target_link_human_indices
    started = False

    def follow(joints: np.ndarray) -> Pose:
        nonlocal started
        human = joints[HUMAN_ORDER]
        if not started:
            solver.warm_start(human[0], palm_alignment(hand, joints[None])[0])
            started = True
        return _with_free_wrist(hand, np.array(solver.retarget(human[indices])), names)

    return follow


def follow_dexi(hand: Hand) -> Follow:
    """By dexi-rs, the same in Rust."""
    import dexi_rs  # pyright: ignore[reportMissingImports]

    options: dict[str, Any] = position_configuration(hand) | {"target_joint_names": list(hand.actuators)}
    with HandUrdf(hand) as path:
        solver = dexi_rs.RetargetingConfig(urdf_path=path, **options).build()
    names, indices = list(solver.joint_names), human_indices(hand)
    started = False

    def follow(joints: np.ndarray) -> Pose:
        nonlocal started
        human = joints[HUMAN_ORDER]
        if not started:
            start = np.zeros(len(names))
            half = hand.all_joints(hand.independent(hand.joint_limits.mean(axis=1)[None])[0])
            start[[names.index(name) for name in hand.joint_names]] = half
            turn = Rotation.from_quat(palm_alignment(hand, joints[None])[0], scalar_first=True)
            start[[names.index(name) for name in DUMMIES]] = np.r_[human[0], turn.as_euler("XYZ")]
            solver.set_qpos(start.tolist())
            started = True
        return _with_free_wrist(hand, np.array(solver.retarget(human[indices].ravel().tolist())), names)

    return follow


def _with_free_wrist(hand: Hand, found: np.ndarray, names: list[str]) -> Pose:
    free = found[[names.index(name) for name in DUMMIES]]
    turn = Rotation.from_euler("XYZ", free[3:]).as_quat(scalar_first=True)
    return np.r_[free[:3], turn], found[[names.index(name) for name in hand.joint_names]]


def follow_mink(hand: Hand) -> Follow:
    """By mink (Zakka, 2024): tasks for the ends of the links, limits of joints, links kept apart."""
    import mink  # pyright: ignore[reportMissingImports]

    spec, points = hand_on_free_joint(hand), HandPoints(HandKinematics(hand, 1))
    match, names = points.match, hand.keypoint_names
    model = spec.compile()
    address = [int(model.jnt_qposadr[model.joint(name).id]) for name in hand.joint_names]
    free = int(model.jnt_qposadr[model.joint("free").id])
    tasks: list[Any] = []
    for link, far in enumerate(match.far):
        is_site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, names[far]) >= 0
        cost, kind = 1.0 if match.is_last[link] else 0.1, "site" if is_site else "body"
        tasks.append(
            mink.FrameTask(names[far], kind, position_cost=cost, orientation_cost=0.0, lm_damping=1e-3)
        )
    others: list[Any] = [mink.PostureTask(model, cost=1e-3)]
    if model.neq:
        others.append(mink.EqualityConstraintTask(model, cost=1.0))
    geoms = list(range(model.ngeom))
    apart = mink.CollisionAvoidanceLimit(
        model, [(geoms, geoms)], minimum_distance_from_collisions=0.0005, collision_detection_distance=0.03
    )
    limits = [mink.ConfigurationLimit(model), apart]
    configuration = mink.Configuration(model)
    started = False

    def follow(joints: np.ndarray) -> Pose:
        nonlocal started
        if not started:
            qpos = np.zeros(model.nq)
            qpos[free : free + 7] = np.r_[joints[0], palm_alignment(hand, joints[None])[0]]
            qpos[address] = hand.all_joints(hand.independent(hand.joint_limits.mean(axis=1)[None])[0])
            configuration.update(qpos)
            started = True
        others[0].set_target(configuration.q)
        for task, human in zip(tasks, match.human_far, strict=True):
            task.set_target(mink.SE3.from_translation(joints[human]))
        for _ in range(STEPS):
            wanted = [*tasks, *others]
            try:
                velocity = mink.solve_ik(
                    configuration, wanted, STEP_TIME, "daqp", damping=1e-4, limits=limits
                )
            except mink.NoSolutionFound:
                velocity = mink.solve_ik(
                    configuration, wanted, STEP_TIME, "daqp", damping=1e-4, limits=limits[:1]
                )
            configuration.integrate_inplace(velocity, STEP_TIME)
        q = configuration.q
        return q[free : free + 7].copy(), q[address].copy()

    return follow


FOLLOWERS: Mapping[str, Callable[[Hand], Follow]] = {
    "fungrasp": follow_fungrasp,
    "dex-retargeting": follow_dex_retargeting,
    "dexi-rs": follow_dexi,
    "mink": follow_mink,
}


@dataclass(frozen=True)
class Followed:
    """One method's hand in T frames."""

    fingertip_error: np.ndarray
    """Mean distance of the fingertips from the person's without noise [mm], shape [T]."""
    pinch_error: np.ndarray
    """Mean error of the vectors from the thumb's tip to the other tips [mm], shape [T]."""
    jitter: np.ndarray
    """Root mean square over the joints of the second difference over frames [mrad], shape [T - 2]."""
    self_penetration: np.ndarray
    """Deepest contact of the hand with itself [mm], shape [T]."""
    milliseconds: np.ndarray
    """Processor time of each frame, shape [T]."""

    def figures(self) -> dict[str, float]:
        """Numbers of the table."""
        return {
            "fingertip_error_mm": float(self.fingertip_error.mean()),
            "fingertip_error_p95_mm": float(np.percentile(self.fingertip_error, 95)),
            "pinch_error_mm": float(self.pinch_error.mean()),
            "jitter_mrad": float(np.sqrt(np.mean(self.jitter**2))),
            "self_penetration_p95_mm": float(np.percentile(self.self_penetration, 95)),
            "self_penetrating_share": float(np.mean(self.self_penetration > 1.0)),
            "median_ms": float(np.median(self.milliseconds)),
        }


def measure(hand: Hand, follow: Follow, seen: np.ndarray, true: np.ndarray) -> Followed:
    """Let a method follow a track.

    Args:
        seen: joints with noise, as the method gets them [m], shape [T, 21, 3].
        true: the same without.
    """
    poses, seconds = [], []
    for joints in seen:
        start = process_time()
        poses.append(follow(joints))
        seconds.append(process_time() - start)
    wrist, angles = (np.array(x) for x in zip(*poses, strict=True))
    kinematics = HandKinematics(hand, len(seen))
    points = HandPoints(kinematics)
    independent = np.clip(hand.independent(angles), kinematics.lower, kinematics.upper)
    kinematics.update(wrist, independent)
    match = points.match
    tips = kinematics.points(points.keypoints)[:, match.far[match.is_last]]
    human = true[:, match.human_far[match.is_last]]
    thumb = int(np.argmax(match.human_far[match.is_last]))
    rest = np.delete(np.arange(tips.shape[1]), thumb)
    vectors = [x[:, rest] - x[:, [thumb]] for x in (tips, human)]
    joints = hand.all_joints(independent)
    return Followed(
        1e3 * np.linalg.norm(tips - human, axis=-1).mean(axis=1),
        1e3 * np.linalg.norm(vectors[0] - vectors[1], axis=-1).mean(axis=1),
        1e3 * np.sqrt(np.mean(np.diff(joints, n=2, axis=0) ** 2, axis=1)),
        1e3 * self_collision_depth(hand.model, joints),
        1e3 * np.array(seconds),
    )


@dataclass(frozen=True)
class FollowPeers:
    """Follow a moving hand, frame by frame, with this package and with the others that are installed."""

    grasps: str = "builtin"
    """A file of human grasps whose hands the track goes through, or "builtin"."""
    hand: str = "allegro"
    """Name of a hand, or the path of a hand's TOML file."""
    method: tuple[str, ...] = ()
    """Which to measure; all that are installed by default."""
    poses: int = 20
    """Recorded hands that the track goes through, spread evenly over the file."""
    frames: int = 30
    """From one to the next: a second at the rate of a camera."""
    noise: float = 0.002
    """Standard deviation of each coordinate of each joint [m]."""
    seed: int = 0
    """Of the noise."""
    json: Path | None = None
    """Write the numbers here (.json), one row for each method and frame in a CSV file beside it."""

    def run(self) -> None:
        there = ["fungrasp", *installed_peers()]
        for name in self.method:
            if name not in FOLLOWERS:
                raise UnknownNameError("method", name, FOLLOWERS)
            if name in PEERS and name not in there:
                raise FungraspError(f"{name} is not installed: pip install 'fungrasp[bench]'")
        hand, human = load_hand(self.hand), load_human_grasps(self.grasps)
        if not 2 <= self.poses <= len(human) or self.frames < 4:
            raise FungraspError(f"--poses must be 2 to {len(human)}, --frames at least 4")
        hands = human.hand_joints[np.linspace(0, len(human) - 1, self.poses).astype(int)].astype(float)
        rng = np.random.default_rng(self.seed)
        true = moving_hand(hands, self.frames, 0.0, rng)
        seen = true + self.noise * rng.normal(size=true.shape)
        results: dict[str, Followed] = {}
        for name in self.method or there:
            try:
                # Compiled loops and caches of the first frame are not measured.
                measure(hand, FOLLOWERS[name](hand), seen[:2], true[:2])
                results[name] = measure(hand, FOLLOWERS[name](hand), seen, true)
            except ImportError as error:
                print(f"{name} is installed, but can't be imported: {error}", file=sys.stderr)
        figures = {name: result.figures() for name, result in results.items()}
        head = ("method", "fingertips [mm]", "p95", "thumb to fingers [mm]", "jitter [mrad]")
        rows: list[tuple[str, ...]] = [(*head, "self-penetration p95 [mm]", "above 1 mm", "ms/frame")]
        for name, f in figures.items():
            values = (f"{f[key]:.1f}" for key in list(f)[:5])
            rows.append((name, *values, f"{f['self_penetrating_share']:.0%}", f"{f['median_ms']:.2f}"))
        print(table(rows))
        print(f"{len(seen)} frames through {self.poses} hands, followed by {hand.name}; {machine()}")
        if self.json is not None:
            about = {"hand": hand.name, "frames": len(seen), "poses": self.poses, "noise_m": self.noise}
            write_result(self.json, {"methods": figures, **run_record(self.seed), **about}, _rows(results))


def _rows(results: Mapping[str, Followed]) -> list[dict[str, Any]]:
    return [
        {
            "method": name,
            "frame": frame,
            "fingertip_error_mm": round(float(result.fingertip_error[frame]), 3),
            "pinch_error_mm": round(float(result.pinch_error[frame]), 3),
            "self_penetration_mm": round(float(result.self_penetration[frame]), 3),
            "milliseconds": round(float(result.milliseconds[frame]), 3),
        }
        for name, result in results.items()
        for frame in range(len(result.milliseconds))
    ]


if __name__ == "__main__":
    main("peers.following", FollowPeers)
