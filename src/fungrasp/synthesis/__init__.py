"""Human grasps written as specifications (object, part, task, kind of grasp) and solved."""

from fungrasp.synthesis.grasp_specification import GRASP_KINDS, GraspKind, GraspSpecification
from fungrasp.synthesis.synthesis_job import synthesize_grasps
from fungrasp.synthesis.synthesize import SynthesisSettings

__all__ = [
    "GRASP_KINDS",
    "GraspKind",
    "GraspSpecification",
    "SynthesisSettings",
    "synthesize_grasps",
]
