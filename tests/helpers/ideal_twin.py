"""A twin that differs from what is believed in nothing that can be drawn."""

from __future__ import annotations

from fungrasp.robots.twin.parameters import TwinSpread

IDEAL = TwinSpread(
    stiffness=(1, 1),
    damping=(1, 1),
    friction=(0, 0),
    sliding=(1, 1),
    torque_limit=(1, 1),
    armature=(1, 1),
    backlash=0,
    encoder_bias=0,
    encoder_step=1e-6,
    hand_delay=(0, 0),
    arm_delay=(0, 0),
    camera_position=0,
    camera_rotation=0,
    tracker_noise=(0, 0),
    tracker_delay=(0, 0),
    tracker_dropout=0,
    mass=(1, 1),
    center_of_mass=0,
    object_friction=(0.9, 0.9),
    surface=0,
    table_tilt=0,
    table_height=0,
)
"""A twin without imperfections: what is left are its other contact model and the dynamics of the arm."""
