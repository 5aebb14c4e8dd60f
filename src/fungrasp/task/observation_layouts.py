"""Which parts of what a robot has (``fungrasp.task.features``) its networks get."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from fungrasp.core.errors import UnknownNameError
from fungrasp.geometry.poses import Array

LayoutName = Literal["full", "paper"]
"""Name of an observation layout."""


@dataclass(frozen=True)
class ObservationLayout:
    """Parts by name, in order."""

    network: tuple[str, ...]
    """What actor and value network get."""
    encoder: tuple[str, ...]
    """What a student's encoder gets of each control step that it looks back on."""


LAYOUTS: Mapping[LayoutName, ObservationLayout] = {
    "full": ObservationLayout(
        (
            "joints",
            "joint_errors",
            "servo_errors",
            "joint_changes",
            "palm_error",
            "palm_change",
            "palm_goal",
            "up",
            "palm_height",
            "object_center",
            "object_extents",
            "object_deviation",
            "object_moved",
            "object_change",
            "keypoint_errors",
            "surface_distances",
            "surface_normals",
            "target_distances",
            "target_normals",
            "target_contacts",
            "mass",
            "phase",
            "last_action",
        ),
        (
            "joints",
            "servo_errors",
            "joint_changes",
            "palm_error",
            "target_contacts",
            "last_action",
            "surface_distances",
        ),
    ),
    # Section IV.B.1, in its order: q_r; the wrist's attitude to the table, its velocity; where the object is
    # and how it is turned from its place in the grasp (T_o, g_r), its velocity, its displacement; the wrist's
    # height; g_p; the target contacts of g_c. Forces and c - c of g_c are privileged. Nothing of it says how
    # far the mesh or a servo's setpoint is, from which contacts could be told. Section IV.C.1: the encoder
    # gets joints, the wrist's difference from its target, target contacts and actions.
    "paper": ObservationLayout(
        (
            "joints",
            "up",
            "palm_change",
            "object_center",
            "object_deviation",
            "object_change",
            "object_moved",
            "palm_height",
            "keypoint_errors",
            "target_contacts",
        ),
        ("joints", "palm_goal", "target_contacts", "last_action"),
    ),
}


def check_layout(name: str) -> None:
    """Complain about a layout that there is not.

    Raises:
        UnknownNameError: there is none of this name.
    """
    if name not in LAYOUTS:
        raise UnknownNameError("observation layout", name, LAYOUTS)


def network_parts(features: Mapping[str, Array], name: LayoutName, encoder: bool) -> dict[str, Array]:
    """What a policy gets of what a robot has.

    Args:
        features: ``robot_features``.
        name: of the layout.
        encoder: whether the policy is a student with an encoder; what only this needs comes last.
    """
    one = LAYOUTS[name]
    names = (*one.network, *(one.encoder if encoder else ()))
    return {part: features[part] for part in dict.fromkeys(names)}


def encoder_parts(features: Mapping[str, Array], name: LayoutName) -> dict[str, Array]:
    """What a student's encoder gets of a control step. Arguments: as for ``network_parts``."""
    return {part: features[part] for part in LAYOUTS[name].encoder}
