"""Protocols, metrics over many episodes, the paper's tables."""

from fungrasp.evaluation.grasp_quality import StaticQuality, static_quality
from fungrasp.evaluation.lift_evaluation import LiftTestResult, evaluate
from fungrasp.evaluation.lift_test_spec import LiftTestSpec
from fungrasp.evaluation.method_comparison import MethodComparison, compare_methods
from fungrasp.evaluation.result_files import ResultFile, read_result, write_result
from fungrasp.evaluation.results import result_json
from fungrasp.evaluation.six_directions import StaticResult, six_direction_test
from fungrasp.evaluation.trajectory import Trajectory, replay
from fungrasp.evaluation.use_recording import UseRecorder

__all__ = [
    "LiftTestResult",
    "LiftTestSpec",
    "MethodComparison",
    "ResultFile",
    "StaticQuality",
    "StaticResult",
    "Trajectory",
    "UseRecorder",
    "compare_methods",
    "evaluate",
    "read_result",
    "replay",
    "result_json",
    "six_direction_test",
    "static_quality",
    "write_result",
]
