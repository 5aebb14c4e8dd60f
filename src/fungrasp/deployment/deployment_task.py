"""A grasp with all that a deployment of it needs: the cell, the policy, its planner, what is known of the
hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.deployment.identified_dynamics import HandDynamics, identified_dynamics
from fungrasp.deployment.preparation import GraspPreparer
from fungrasp.deployment.spec import DeploymentSpec
from fungrasp.grasps import RobotGraspSet
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel, check_objects
from fungrasp.planning import Planner, make_planner
from fungrasp.planning.attempts import check_attempts
from fungrasp.planning.given_plans import GivenPlans
from fungrasp.planning.selection import SelectionSettings
from fungrasp.policies import OpenLoopPolicy, make_policy
from fungrasp.robots.assembly import is_twin
from fungrasp.robots.cell import RobotCell, check_calibrated, load_cell, plan_speed, slowest_limit
from fungrasp.task import GraspPlan, Policy


@dataclass(frozen=True, eq=False)
class DeploymentTask:
    """What a specification names, loaded."""

    spec: DeploymentSpec
    """What is asked."""
    cell: RobotCell
    """The robot."""
    hand: Hand
    """On its arm."""
    obj: ObjectModel
    """The object as it is believed."""
    grasp: RobotGraspSet
    """One."""
    policy: Policy
    """What acts."""
    planner: Planner
    """Of the policy."""
    dynamics: HandDynamics | None = None
    """Identified, of the hand; the model's if None."""

    def preparer(self, advise: bool = True) -> GraspPreparer:
        """What plans. advise: whether a placement that would do is looked for where the object's does not."""
        return GraspPreparer(
            self.cell, self.hand, self.obj, self.planner, self.dynamics, self.spec.seed, advise=advise
        )

    @property
    def stiffness(self) -> np.ndarray | None:
        """Of the hand's servos, where it was identified [N m/rad], shape [U]; None for the model's."""
        return None if self.dynamics is None else self.dynamics.stiffness(self.hand)


def deployment_task(
    robot: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    spec: DeploymentSpec,
    plans: GraspPlan | None = None,
) -> DeploymentTask:
    """Load what a specification names.

    Args:
        robot: one grasp, of the cell's hand.
        plans: one plan for it, to be followed in the place of one that the policy's planner makes.

    Raises:
        FungraspError: several grasps, grasps of another hand, no such cell or policy, a cell that is not
            calibrated, or several attempts or another speed with a policy for which these make no sense.
    """
    if len(robot) != 1:
        raise FungraspError(f"one grasp is deployed at a time, not {len(robot)}: select one, as in robot[:1]")
    check_objects(robot.object_name.tolist(), objects)
    obj, cell = objects[str(robot.object_name[0])], load_cell(spec.cell)
    if not is_twin(cell):
        check_calibrated(cell)
    hand = load_hand(cell.hand)
    if robot.hand != hand.name:
        raise FungraspError(
            f"robot cell '{cell.name}' carries the hand '{hand.name}', and the grasp is of '{robot.hand}'"
        )
    limited, dynamics = identified_dynamics(cell, hand, spec.hand_dynamics)
    policy = deployable_policy(spec.policy, hand, {obj.name: obj})
    watches = not isinstance(policy, OpenLoopPolicy)
    check_attempts(spec.attempts, watches)
    if spec.speed < 1.0 and watches:
        raise FungraspError(
            f"the policy '{spec.policy}' watches what it does and acts at 10 Hz: it can't be slowed down to "
            f'{spec.speed:g}; the policies "plan" and "reference" can'
        )
    if watches and plan_speed(cell.limits) < 1.0:
        raise FungraspError(
            f"with {slowest_limit(cell.limits)} plans are carried out at {plan_speed(cell.limits):.2g} of "
            f"their speed, and the policy '{spec.policy}' watches what it does and can't be slowed down; the "
            'policies "plan" and "reference" can'
        )
    planner = (
        robot_planner(spec.policy, limited, {obj.name: obj}, spec.threads)
        if plans is None
        else GivenPlans(plans, robot)
    )
    return DeploymentTask(spec, cell, hand, obj, robot, policy, planner, dynamics)


def robot_planner(name: str, hand: Hand, objects: Mapping[str, ObjectModel], threads: int = 0) -> Planner:
    """The planner of the policy of a name on a robot: a robot differs from its model, so that candidates are
    tried in the worlds of the reality protocol. threads: 0 means all processors.

    Raises:
        FungraspError: no such policy, or one for another hand.
    """
    return make_planner(name, hand, objects, SelectionSettings.for_protocol("reality"), threads=threads)


def deployable_policy(name: str, hand: Hand, objects: Mapping[str, ObjectModel]) -> Policy:
    """The policy of a name, if a robot can run it.

    Raises:
        FungraspError: there is none, or it needs what only a simulation knows.
    """
    policy = make_policy(name, hand, objects)
    if not isinstance(policy, Policy):
        raise FungraspError(f"the policy '{name}' needs what only a simulation knows: take a student")
    return policy
