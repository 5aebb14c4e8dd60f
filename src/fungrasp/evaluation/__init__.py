"""Protocols, metrics over many trials, the paper's tables."""

from fungrasp.evaluation.dynamic import DynamicResult, evaluate
from fungrasp.evaluation.quality import StaticQuality, static_quality
from fungrasp.evaluation.results import result_json
from fungrasp.evaluation.robustness import Disturbance
from fungrasp.evaluation.trajectory import Trajectory, replay

__all__ = [
    "Disturbance",
    "DynamicResult",
    "StaticQuality",
    "Trajectory",
    "evaluate",
    "replay",
    "result_json",
    "static_quality",
]
