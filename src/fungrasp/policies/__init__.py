"""Things that act."""

from fungrasp.policies.motion import ReferenceSettings
from fungrasp.policies.play import POLICIES, Policy, chooses, free_policy, make_policy, play, resolve_policy
from fungrasp.policies.reference import ReferenceController
from fungrasp.policies.refine import refine

__all__ = [
    "POLICIES",
    "Policy",
    "ReferenceController",
    "ReferenceSettings",
    "chooses",
    "free_policy",
    "make_policy",
    "play",
    "refine",
    "resolve_policy",
]
