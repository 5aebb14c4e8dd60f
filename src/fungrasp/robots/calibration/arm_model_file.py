"""A model of one UR arm, with the kinematics that its maker has calibrated and its controller tells."""

from __future__ import annotations

import socket
import time
from pathlib import Path

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path
from fungrasp.hands.arm import arm_spec
from fungrasp.robots.arms.ur import BASE
from fungrasp.robots.codecs.ur_primary import decode_kinematics
from fungrasp.robots.device import RobotError
from fungrasp.robots.kinematics.dh_parameters import DHParameters, moved_to_parameters
from fungrasp.robots.kinematics.flange_chain import chain_of_model

PRIMARY_PORT = 30001
PATIENCE = 5.0
"""A controller that has not told its kinematics by then tells none [s]; it sends its state ten times a
second."""

LARGEST_CHANGE = 0.02
"""A calibrated flange is not farther from the nominal one than this in any posture [m]: calibrations change
a millimeter or two, another type of arm at least 60 mm."""

POSTURES = 1000
"""In which the two are compared, drawn with seed 0."""


def read_kinematics(address: str) -> DHParameters:
    """The kinematics of the arm at a controller. Only listens: nothing is sent, no program ends.

    Raises:
        RobotError: no controller there, or one that does not say (CB3 before software 3.6).
    """
    end, stream = time.monotonic() + PATIENCE, b""
    try:
        with socket.create_connection((address, PRIMARY_PORT), PATIENCE) as connection:
            while time.monotonic() < end and (data := connection.recv(1 << 16)):
                parameters, stream = decode_kinematics(stream + data)
                if parameters is not None:
                    return parameters
    except TimeoutError:
        pass
    except (OSError, ValueError) as error:
        raise RobotError(f"{address}: {error}; check address and cable of the controller") from error
    raise RobotError(f"{address}: the controller does not tell its kinematics: has it software below 3.6?")


def write_arm_model(path: str | Path, arm: str, parameters: DHParameters) -> float:
    """Write the model of one arm.

    Args:
        path: of the model (.xml), for ``arm.model`` of a cell.
        arm: the model of its type, "ur5" or "ur5e".
        parameters: of the arm.

    Returns:
        Largest distance of its flange from the type's over many postures [m].

    Raises:
        FungraspError: the parameters are not those of such an arm, or the file can't be written.
    """
    if Path(path).suffix != ".xml":
        raise FungraspError(f"{path}: the model of an arm is an .xml file")
    if not all(
        np.isfinite(v).all() for v in (parameters.theta, parameters.a, parameters.d, parameters.alpha)
    ):
        raise FungraspError("the controller's kinematics are not numbers: restart it")
    spec = arm_spec(arm)
    nominal = chain_of_model(spec)
    moved_to_parameters(spec, parameters, BASE)
    moved = chain_of_model(spec)
    postures = np.random.default_rng(0).uniform(-np.pi, np.pi, (POSTURES, len(parameters.a)))
    change = max(float(np.linalg.norm((moved.flange_pose(q) - nominal.flange_pose(q))[:3])) for q in postures)
    if change > LARGEST_CHANGE:
        raise FungraspError(
            f"the controller's kinematics put the flange up to {1e3 * change:.0f} mm from that of a {arm}: "
            'is the arm of another type ("ur5" for CB3, "ur5e")?'
        )
    with atomic_path(path) as temporary:
        temporary.write_text(spec.to_xml())
    return change
