"""Policies, which map observations to actions ten times per second."""

from fungrasp.policies.open_loop import OpenLoopPolicy
from fungrasp.policies.registry import default_policy, make_policy, policy_source
from fungrasp.policies.residual_policy import StudentPolicy, TeacherPolicy

__all__ = [
    "OpenLoopPolicy",
    "StudentPolicy",
    "TeacherPolicy",
    "default_policy",
    "make_policy",
    "policy_source",
]
