"""fungrasp: a human grasp in, a robot grasp that lifts the object out.

Six verbs are the product: ``perceive``, ``retarget``, ``plan``, ``evaluate``, ``deploy`` and ``view``; and
``train`` makes policies. What one returns, the next one takes. Five nouns are what they are about:
``HumanGrasp``, ``RobotGrasp``, ``GraspPlan``, ``Observation`` and ``Action``. See docs/concepts.md.

The names below are those of the subpackages (``fungrasp.load_hand`` is ``fungrasp.hands.load_hand``). A
subpackage is imported when one of its names is first used, so that ``import fungrasp`` costs nothing; type
checkers read ``__init__.pyi``. Nothing in the package imports from here.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any

from fungrasp.core import __version__ as __version__
from fungrasp.core.lazy_names import lazy_names

_NAMES = {
    "deployment.deploy": "deploy",
    "deployment.observer": "DeploymentObserver",
    "deployment.spec": "DeploymentSpec",
    "evaluation": "LiftTestSpec evaluate static_quality",
    "grasps": (
        "HumanGrasp HumanGraspSet RobotGrasp RobotGraspSet builtin_grasps load_grasps load_human_grasps "
        "load_objects load_robot_grasps save_human_grasps save_robot_grasps"
    ),
    "grasps.from_arrays": "human_grasp",
    "hands": "Hand load_hand",
    "core.jobs": "PartStore RayCluster",
    "objects": "ObjectModel load_object object_from_mesh",
    "perception.pipeline": "perceive",
    "planning": "MotionPlanner Planner make_planner plan",
    "policies": "make_policy",
    "retargeting": "retarget",
    "retargeting.retargeter": "Retargeter",
    "sim2real": "Randomization",
    "simulation": "Engine build_scene",
    "training.settings": "TrainSpec",
    "training.train": "train",
    "training.training_sets": "TrainingSet",
    "viewer.view": "view",
    "task": "Action Belief GraspPlan LiftEnvironment Observation Policy play",
}
"""Names that are offered here, by the module that they come from."""

__getattr__ = lazy_names(__name__, _NAMES)
__all__ = sorted(name for names in _NAMES.values() for name in names.split())  # pyright: ignore[reportUnsupportedDunderAll]


def __dir__() -> list[str]:
    return [*globals(), *__all__]


_SHOWN = {
    "grasps.human_grasp": "HumanGraspSet",
    "grasps.robot_grasp": "RobotGraspSet",
    "evaluation.results": "LiftTestResult",
    "task.grasp_plan": "GraspPlan",
}
"""What notebooks show by a picture and a table, by the module that it comes from."""


def _tell_notebooks() -> None:
    """Tell Jupyter how to show them; nothing is imported before one is shown."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if shell is not None:
        html = shell.display_formatter.formatters["text/html"]
        for module, name in _SHOWN.items():
            html.for_type_by_name(f"fungrasp.{module}", name, _notebook_html)


def _notebook_html(value: Any) -> str | None:
    return import_module("fungrasp.media.grasp_pages").notebook_html(value)


_tell_notebooks()
