"""fungrasp: from human grasps to robot grasps that lift the object.

The main functions are ``perceive``, ``retarget``, ``plan``, ``evaluate``, ``deploy``, ``view`` and ``train``.
Each accepts what the previous one returns. The main types are ``HumanGrasp``, ``RobotGrasp``, ``GraspPlan``,
``Observation`` and ``Action``. See docs/concepts.md.

All names come from subpackages (``fungrasp.load_hand`` is ``fungrasp.hands.load_hand``), which are imported
on first use, so ``import fungrasp`` is fast. Type checkers read ``__init__.pyi``. The package itself does not
import from here.
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
    "core.errors": "FungraspError",
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
"""Public names by module."""

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
"""Types with a picture and a table in notebooks, by module."""


def _tell_notebooks() -> None:
    """Register the types with Jupyter, without importing them."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if shell is not None:
        html = shell.display_formatter.formatters["text/html"]
        for module, name in _SHOWN.items():
            html.for_type_by_name(f"fungrasp.{module}", name, _notebook_html)


def _notebook_html(value: Any) -> str | None:
    return import_module("fungrasp.media.grasp_pages").notebook_html(value)


_tell_notebooks()
