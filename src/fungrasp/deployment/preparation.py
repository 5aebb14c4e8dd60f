"""Preparation of a grasp before anything moves: a plan for the tracked object that the arm can follow."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Protocol

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import (
    compose,
    quaternion_from_rotation_vector,
    quaternion_multiply,
    relative,
    rotation_vector,
    turned_towards,
)
from fungrasp.grasps import RobotGraspSet
from fungrasp.grasps.conversion import settled_pose
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_model import broad_settled_up
from fungrasp.planning import ConstrainedPlanner, MotionPlanner, Planner
from fungrasp.planning.attempts import ATTEMPT_SEEDS, NOT_WORTH_TRYING, worth_trying
from fungrasp.planning.given_plans import GivenPlans
from fungrasp.policies.slip_response import HIGHEST
from fungrasp.robots.cell import RobotCell
from fungrasp.robots.kinematics.arm_model import ArmKinematics, ClearanceModel, outside
from fungrasp.robots.kinematics.joint_path import FreePath
from fungrasp.robots.kinematics.reach import PalmPath, Reach, ReachChecker
from fungrasp.sim2real.joint_dynamics import HandDynamics
from fungrasp.task import Belief, GraspPlan, LiftProtocol
from fungrasp.task.start_pose import StartPoses, start_fingers

SHIFTS = (0.0, -0.1, 0.1)
"""Displacements of the object along both axes that are tried if it is out of reach [m]."""

PLACEMENTS = 60
"""Number of placements that are tried, those with the smallest moves first."""

PLANS = 3
"""Number of plans, each with its own seed, before a grasp counts as unreachable. The planner ignores the arm,
which often can follow the next plan, or reach its start, if it fails with the first."""

ANOTHER = "take another grasp: higher on the object, or from above"
"""Advice for a grasp that is unreachable in all placements: mostly, the flange does not fit between hand and
table."""

TURNS = np.deg2rad([0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180])
"""Turns of the object about the vertical that are tried [rad]."""

ROOM = 0.02
"""Distance of the palm from the sides of the workspace in proposed placements [m]: tracked poses are off by
up to a centimeter, and plans differ."""

PLACEMENTS_PLANNED = 12
"""Number of placements for which a motion is planned, a second or two each."""


@dataclass(frozen=True, eq=False)
class PreparedGrasp:
    """A plan, and the motion of the arm that carries it out."""

    plan: GraspPlan
    """One plan, world frame of the cell."""
    start_fingers: np.ndarray
    """Independent joints at the start [rad], shape [U]."""
    reach: Reach
    """Arm motion along the plan."""
    corners: tuple[np.ndarray, ...]
    """Postures of the arm from its current one (excluded) to the start of the plan (included) [rad], shape
    [A] each."""


class Preparer(Protocol):
    """Prepares grasps before anything moves."""

    objects: Mapping[str, ObjectModel]
    """The object by its name."""

    def prepare(
        self, grasp: RobotGraspSet, object_pose: np.ndarray, arm: np.ndarray, *, attempt: int = 0
    ) -> PreparedGrasp:
        """Plan a grasp of the object at its tracked pose.

        Args:
            object_pose: pose of the resting object, world frame, shape [7].
            arm: current joints of the arm [rad], shape [A].
            attempt: number of failed attempts.

        Raises:
            UnreachableError: the arm can't follow any plan, or plans have little expected success.
        """
        ...


class UnreachableError(FungraspError):
    """The arm can't follow the plan. The message names a reachable placement of the object, if one exists."""


class GraspPreparer(Preparer):
    """Prepares grasps for one robot."""

    def __init__(
        self,
        cell: RobotCell,
        hand: Hand,
        obj: ObjectModel,
        planner: Planner,
        dynamics: HandDynamics | None = None,
        seed: int = 0,
        *,
        advise: bool = True,
    ):
        """
        Args:
            dynamics: identified dynamics of the hand; those of its model if None.
            advise: whether errors name a placement that the arm can reach.
        """
        self._advise = advise
        self._cell, self._hand, self._obj, self._planner = cell, hand, obj, planner
        self.objects: Mapping[str, ObjectModel] = {obj.name: obj}
        """The object by its name."""
        self._dynamics, self._seed = dynamics, seed
        self._kinematics, self._clearance = ArmKinematics(cell, hand), ClearanceModel(cell, hand, obj)
        self._rng = np.random.default_rng(seed)
        self._reach = ReachChecker(cell, self._kinematics, self._clearance, self._rng)
        self._starts = StartPoses(hand, [obj])
        self._protocol = LiftProtocol()

    def prepare(
        self,
        grasp: RobotGraspSet,
        object_pose: np.ndarray,
        arm: np.ndarray,
        *,
        plans: int = PLANS,
        attempt: int = 0,
    ) -> PreparedGrasp:
        """See ``Preparer.prepare``. plans: number of plans that are tried, 1 or more."""
        beyond = outside(self._kinematics.palm_pose(arm), self._cell.workspace)
        if beyond:
            raise UnreachableError(
                f"with the arm in its current posture, {beyond}: move it by hand, or enlarge the workspace"
            )
        # A quick check, before time is spent on planning.
        obstacle = self.obstacle(grasp, object_pose, arm)
        if obstacle:
            raise UnreachableError(self._advice(grasp, object_pose, obstacle))
        start, fingers = self._start(grasp, object_pose)
        belief, blocked = self._belief(grasp, object_pose, start, fingers), False

        def followed(plans: GraspPlan) -> np.ndarray:
            one = (plans.select(np.array([i])) for i in range(len(plans)))
            return self._reach.followed([self._path(plan, start, fingers) for plan in one], arm)

        for number in range(plans):
            seed = self._seed + ATTEMPT_SEEDS * attempt + number
            if isinstance(self._planner, ConstrainedPlanner):
                plan = self._planner.plan_within(grasp, belief, followed, seed)
            else:
                plan = self._planner.plan(grasp, belief, seed)
            if attempt and not worth_trying(plan)[0]:
                obstacle = NOT_WORTH_TRYING
                continue
            found, obstacle = self._reach.best(self._path(plan, start, fingers), arm)
            free = FreePath(self._kinematics, self._clearance, self._cell.workspace)
            for reach in found:
                corners = free.find(arm, reach.start, fingers, object_pose, self._rng)
                if corners is not None:
                    return PreparedGrasp(plan, fingers, reach, tuple(corners))
            blocked = blocked or bool(found)
        if blocked:
            raise UnreachableError(
                f"no collision-free path to the start of the grasp of '{self._obj.name}': "
                "move the arm by hand to a higher place"
            )
        raise UnreachableError(self._advice(grasp, object_pose, obstacle))

    def _start(self, grasp: RobotGraspSet, object_pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return palm pose, shape [7], and fingers, shape [U], at the start, as in the lift test."""
        p, first = self._protocol, np.array([0])
        fingers = start_fingers(self._hand, grasp, p.start_closing)
        if isinstance(self._planner, GivenPlans):
            return compose(object_pose, self._planner.plans.palm_setpoint_object[0, 0]), fingers[0]
        start, _ = self._starts.facing(
            grasp, first, object_pose[None], p.start_distance, fingers, np.zeros(1)
        )
        return start[0], fingers[0]

    def _belief(
        self, grasp: RobotGraspSet, object_pose: np.ndarray, start: np.ndarray, fingers: np.ndarray
    ) -> Belief:
        belief = Belief.nominal(object_pose[None], grasp.object_mass.copy(), start[None], fingers[None])
        d, factors = self._dynamics, {}
        if d is not None:
            damping, stiffness = d.damping[None], d.servo_stiffness[None]
            factors = {"joint_damping": damping, "servo_stiffness": stiffness, "servo_damping": damping}
        return replace(belief, object_mass_spread=grasp.object_mass_spread, **factors)

    def _path(self, plan: GraspPlan, start: np.ndarray, fingers: np.ndarray) -> PalmPath:
        """Return the motion of the plan, with a lift as high as a policy may go."""
        palm = compose(plan.object_pose[:1, None], plan.palm_setpoint_object[:1])[0]
        up = palm[-1:].copy()
        rise = np.linspace(0.0, self._protocol.lift_height + HIGHEST, 8)[1:]
        up = np.repeat(up, len(rise), axis=0)
        up[:, 2] += rise
        # Once they close, the object stops the fingers near their angles in the grasp.
        joints = np.concatenate([fingers[None], plan.finger_targets[0, :-1]])
        joints[int(plan.closing_step[0]) + 1 :] = plan.grasp_joints[0]
        last = np.repeat(plan.grasp_joints[:1], len(rise), axis=0)
        return PalmPath(
            np.concatenate([start[None], palm[1:], up]), np.concatenate([joints, last]), plan.control_period
        )

    def obstacle(self, grasp: RobotGraspSet, object_pose: np.ndarray, arm: np.ndarray) -> str:
        """Return why the arm can't follow a rough motion, straight to the grasp, then up, as a phrase; "" if
        it can. object_pose: as for ``prepare``; arm: its initial joints [rad], shape [A]."""
        start, fingers = self._start(grasp, object_pose)
        target = compose(object_pose[None], grasp.wrist_pose_object)[0]
        share = np.linspace(0.0, 1.0, 9)[:, None]
        # A start that was turned upwards turns back on the way.
        angle = np.linalg.norm(rotation_vector(relative(start, target)[3:]))
        turned = turned_towards(start[3:], target[3:], share * angle)
        there = np.concatenate([start[:3] + share * (target[:3] - start[:3]), turned], axis=1)
        up = np.repeat(there[-1:], 4, axis=0)
        up[:, 2] += np.linspace(0.0, self._protocol.lift_height + HIGHEST, 5)[1:]
        palm = np.concatenate([there, up])
        return self._reach.possible(PalmPath(palm, np.tile(fingers, (len(palm), 1)), 0.3), arm)

    def placements(self, grasp: RobotGraspSet, object_pose: np.ndarray) -> Iterator[tuple[np.ndarray, str]]:
        """Yield object poses on the table with a grasp that the arm can probably reach, smallest move first,
        and the move in words. The unmoved object is tried as well. object_pose: as for ``prepare``."""
        moves = [(x, y, turn) for turn in TURNS for x in SHIFTS for y in SHIFTS]
        moves.sort(key=lambda move: abs(move[0]) + abs(move[1]) + 0.1 * abs(move[2]))
        home = np.asarray(self._cell.arm.home)
        for x, y, turn in moves[:PLACEMENTS]:
            moved = object_pose.copy()
            moved[:2] += x, y
            rotation = quaternion_from_rotation_vector(np.array([0.0, 0.0, turn]))
            moved[3:] = quaternion_multiply(rotation, moved[3:])
            if not self.obstacle(grasp, moved, home):
                yield (
                    moved,
                    f"moved by ({100 * x:g}, {100 * y:g}) cm and turned by {np.rad2deg(turn):.0f} degrees "
                    "about the vertical",
                )

    def _advice(self, grasp: RobotGraspSet, object_pose: np.ndarray, obstacle: str) -> str:
        """Return the obstacle and a reachable placement in one line."""
        said = f"the grasp of '{self._obj.name}' is not reachable: {obstacle}"
        if not self._advise:
            return said
        moved = (p for p in self.placements(grasp, object_pose) if not np.array_equal(p[0], object_pose))
        found = next(moved, None)
        if found is None:
            return f"{said}; no placement nearby would do: {ANOTHER}"
        return f"{said}; it would be reachable with the object {found[1]}"


def reachable_placements(
    cell: RobotCell,
    hand: Hand,
    obj: ObjectModel,
    grasp: RobotGraspSet,
    seed: int = 0,
    planner: Planner | None = None,
) -> Iterator[np.ndarray]:
    """Yield placements of the object with a reachable grasp, near the middle of the workspace.

    First come placements in which the arm can follow a planned motion; then the first of those that only pass
    the rough check, as the robot's planner may find another motion.

    Args:
        seed: for plans and arm postures that are tried.
        planner: planner of that motion; a ``MotionPlanner``, without candidates, if None.

    Yields:
        pose of the object, world frame, shape [7].

    Raises:
        UnreachableError: there is no placement.
    """
    # Tracked poses are off by millimeters, so margins are larger than needed: by half of the table clearance
    # for the arm and for the fingers, about the error of a tracked height.
    box = cell.workspace
    inner = np.array([ROOM, ROOM, 0.0])
    roomy = replace(
        box,
        lower=tuple(np.add(box.lower, inner).tolist()),
        upper=tuple(np.subtract(box.upper, inner).tolist()),
        table_clearance=1.5 * box.table_clearance,
        hand_depth=box.hand_depth - 0.5 * box.table_clearance,
    )
    cell = replace(cell, workspace=roomy)
    planner = planner or MotionPlanner(hand, {obj.name: obj})
    preparer = GraspPreparer(cell, hand, obj, planner, seed=seed, advise=False)
    home = np.asarray(cell.arm.home)
    refused, found = None, False
    middle = settled_pose(grasp.object_rest_pose[0], obj, broad_settled_up)
    middle[:2] = 0.5 * (np.array(box.lower[:2]) + box.upper[:2])
    for pose, _ in islice(preparer.placements(grasp, middle), PLACEMENTS_PLANNED):
        try:
            preparer.prepare(grasp, pose, home, plans=1)
        except UnreachableError:
            refused = pose if refused is None else refused
            continue
        found = True
        yield pose
    if refused is not None:
        yield refused
    elif not found:
        why = preparer.obstacle(grasp, middle, home)
        raise UnreachableError(
            f"no placement of '{obj.name}' was found from which the arm can grasp it: "
            + (f"{why}; {ANOTHER}" if why else ANOTHER)
        )
