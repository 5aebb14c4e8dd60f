"""fungrasp: a human grasp in, a robot grasp that lifts the object out.

Five nouns carry the system: ``HumanGrasp``, ``RobotGrasp``, ``GraspPlan``, ``Observation`` and ``Action``;
everything else is a verb between two of them. See docs/architecture.md.

The names below are those of the rooms (``fungrasp.load_hand`` is ``fungrasp.hands.load_hand``). A room is
imported when one of its names is first used, so that ``import fungrasp`` costs nothing. Retargeting is
``fungrasp.retargeting.retarget``: the room has the verb's name.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fungrasp.evaluation import evaluate as evaluate
    from fungrasp.evaluation import static_quality as static_quality
    from fungrasp.grasps import HumanGrasp as HumanGrasp
    from fungrasp.grasps import HumanGraspSet as HumanGraspSet
    from fungrasp.grasps import RobotGrasp as RobotGrasp
    from fungrasp.grasps import RobotGraspSet as RobotGraspSet
    from fungrasp.grasps import builtin_grasps as builtin_grasps
    from fungrasp.grasps import load_human_grasps as load_human_grasps
    from fungrasp.grasps import load_objects as load_objects
    from fungrasp.grasps import load_robot_grasps as load_robot_grasps
    from fungrasp.grasps import save_human_grasps as save_human_grasps
    from fungrasp.grasps import save_robot_grasps as save_robot_grasps
    from fungrasp.hands import Hand as Hand
    from fungrasp.hands import load_hand as load_hand
    from fungrasp.objects import ObjectModel as ObjectModel
    from fungrasp.objects import load_object as load_object
    from fungrasp.perception.pipeline import perceive as perceive
    from fungrasp.planning import MotionPlanner as MotionPlanner
    from fungrasp.planning import Planner as Planner
    from fungrasp.policies import make_planner as make_planner
    from fungrasp.policies import make_policy as make_policy
    from fungrasp.sim2real import Randomization as Randomization
    from fungrasp.simulation import Engine as Engine
    from fungrasp.simulation import build_scene as build_scene
    from fungrasp.task import Action as Action
    from fungrasp.task import Belief as Belief
    from fungrasp.task import GraspPlan as GraspPlan
    from fungrasp.task import LiftEnvironment as LiftEnvironment
    from fungrasp.task import Observation as Observation
    from fungrasp.task import Policy as Policy
    from fungrasp.task import play as play

__version__ = "0.1.0"

_NAMES = {
    "evaluation": "evaluate static_quality",
    "grasps": (
        "HumanGrasp HumanGraspSet RobotGrasp RobotGraspSet builtin_grasps load_objects "
        "load_human_grasps load_robot_grasps save_human_grasps save_robot_grasps"
    ),
    "hands": "Hand load_hand",
    "objects": "ObjectModel load_object",
    "perception.pipeline": "perceive",
    "planning": "MotionPlanner Planner",
    "policies": "make_planner make_policy",
    "simulation": "Engine build_scene",
    "task": "Action Belief GraspPlan LiftEnvironment Observation Policy play",
    "sim2real": "Randomization",
}
"""Names that are offered here, by the module that they come from."""

_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'fungrasp' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(f"fungrasp.{_MODULES[name]}"), name)
    return value


def __dir__() -> list[str]:
    return [*globals(), *_MODULES]
