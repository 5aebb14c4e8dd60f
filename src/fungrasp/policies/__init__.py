"""Policies: they see observations and nothing else, and act ten times a second."""

from fungrasp.policies.registry import default_policy, make_policy, policy_files
from fungrasp.policies.residual_policy import StudentPolicy, TeacherPolicy
from fungrasp.policies.scripted import OpenLoopPolicy

__all__ = [
    "OpenLoopPolicy",
    "StudentPolicy",
    "TeacherPolicy",
    "default_policy",
    "make_policy",
    "policy_files",
]
