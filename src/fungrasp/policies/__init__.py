"""Policies: they see observations and nothing else, and act ten times a second."""

from fungrasp.policies.open_loop import OpenLoopPolicy
from fungrasp.policies.registry import check_attempts, default_policy, make_planner, make_policy, policy_files
from fungrasp.policies.residual_policy import StudentPolicy, TeacherPolicy

__all__ = [
    "OpenLoopPolicy",
    "StudentPolicy",
    "TeacherPolicy",
    "check_attempts",
    "default_policy",
    "make_planner",
    "make_policy",
    "policy_files",
]
