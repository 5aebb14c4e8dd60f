"""Synthesis of human grasps from specifications (object, part, task, kind of grasp)."""

from fungrasp.synthesis.grasp_specification import GRASP_KINDS, GraspKind, GraspSpecification
from fungrasp.synthesis.synthesize import SynthesisSettings, synthesize_grasps

__all__ = [
    "GRASP_KINDS",
    "GraspKind",
    "GraspSpecification",
    "SynthesisSettings",
    "synthesize_grasps",
]
