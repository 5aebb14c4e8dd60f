"""Evaluation: protocols, metrics and tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fungrasp.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from fungrasp.evaluation.grasp_quality import StaticQuality, static_quality
    from fungrasp.evaluation.lift_evaluation import evaluate
    from fungrasp.evaluation.lift_test_spec import LiftTestSpec
    from fungrasp.evaluation.result_files import ResultFile, read_result, write_result
    from fungrasp.evaluation.results import LiftTestResult, result_json
    from fungrasp.evaluation.trajectory import Trajectory, UseRecorder, replay

__all__ = [
    "LiftTestResult",
    "LiftTestSpec",
    "ResultFile",
    "StaticQuality",
    "Trajectory",
    "UseRecorder",
    "evaluate",
    "read_result",
    "replay",
    "result_json",
    "static_quality",
    "write_result",
]

__getattr__ = lazy_names(
    __name__,
    {
        "grasp_quality": "StaticQuality static_quality",
        "lift_evaluation": "evaluate",
        "lift_test_spec": "LiftTestSpec",
        "result_files": "ResultFile read_result write_result",
        "results": "LiftTestResult result_json",
        "trajectory": "Trajectory UseRecorder replay",
    },
)
