"""Protocols, metrics over many trials, the paper's tables."""

from fungrasp.evaluation.lift_test import DynamicResult, evaluate
from fungrasp.evaluation.quality import StaticQuality, static_quality
from fungrasp.evaluation.result_files import ResultFile, read_result, write_result
from fungrasp.evaluation.results import result_json
from fungrasp.evaluation.robustness import CONDITIONS, Disturbance
from fungrasp.evaluation.six_directions import StaticResult, six_direction_test
from fungrasp.evaluation.trajectory import Trajectory, replay

__all__ = [
    "CONDITIONS",
    "Disturbance",
    "DynamicResult",
    "ResultFile",
    "StaticQuality",
    "StaticResult",
    "Trajectory",
    "evaluate",
    "read_result",
    "replay",
    "result_json",
    "six_direction_test",
    "static_quality",
    "write_result",
]
