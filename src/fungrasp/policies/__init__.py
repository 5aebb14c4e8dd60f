"""Policies: they see observations and nothing else, and act ten times a second."""

from fungrasp.policies.registry import (
    POLICIES,
    Policy,
    chooses,
    free_policy,
    make_policy,
    play,
    resolve_policy,
)
from fungrasp.policies.scripted import ReferenceController

__all__ = [
    "POLICIES",
    "Policy",
    "ReferenceController",
    "chooses",
    "free_policy",
    "make_policy",
    "play",
    "resolve_policy",
]
