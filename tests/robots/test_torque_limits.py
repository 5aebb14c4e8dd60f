"""The torques that a hand's driver sends are those that planners and twins know."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from ideal_twin import IDEAL
from robot_cells import cell_and_hand, grasp_and_object

from fungrasp.core.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.robots.assembly import driver_torque_limits, identified_dynamics, limited_hand
from fungrasp.robots.cell import RobotCell, load_cell
from fungrasp.robots.hands import allegro_bus as codec
from fungrasp.robots.twin.parameters import draw_twin
from fungrasp.robots.twin.world import TwinWorld
from fungrasp.sim2real.joint_dynamics import (
    identified_hand,
    load_dynamics,
    model_dynamics,
    save_dynamics,
    set_dynamics,
)

pytest.importorskip("mink")


def with_options(cell: RobotCell, **options: Any) -> RobotCell:
    device = cell.hand_device
    return replace(cell, hand_device=replace(device, options={**device.options, **options}))


def force_limits(hand: Any) -> np.ndarray:
    return np.array([servo.force_limit for servo in hand.actuators.values()])


@pytest.mark.parametrize(
    "generation, share, units",
    [(4, 1.0, codec.ALLEGRO_V4), (5, 1.0, codec.ALLEGRO_V5), (4, 0.2, codec.ALLEGRO_V4)],
)
def test_a_planner_knows_what_is_sent_on_the_bus(generation: int, share: float, units: Any) -> None:
    pytest.importorskip("can")
    cell, hand = load_cell("ur5e-allegro-emulated"), load_hand("allegro")
    cell = with_options(cell, generation=generation, torque_share=share)
    planned = identified_dynamics(cell, hand)[0]
    # What the frames hold where a joint asks for more than any allows.
    frames = codec.encode_torques(units, np.full(16, 100.0))
    sent = np.frombuffer(b"".join(frames), "<i2") / units.counts_per_torque
    np.testing.assert_allclose(force_limits(planned), np.minimum(force_limits(hand), share * sent), rtol=1e-3)
    assert (force_limits(planned) < force_limits(hand)).all()
    # The model that rollouts run, too.
    np.testing.assert_allclose(planned.model.actuator_forcerange[:, 1], force_limits(planned))


def test_a_hand_that_limits_its_torques_itself_keeps_those_of_its_model() -> None:
    cell, hand = load_cell("ur5e-inspire-emulated"), load_hand("inspire")
    assert np.isinf(driver_torque_limits(cell, hand)).all()
    np.testing.assert_array_equal(force_limits(limited_hand(cell, hand)), force_limits(hand))


@pytest.mark.parametrize("limits", [0.1, [0.05, 0.1, 0.15, 0.2] * 4])
def test_a_twin_makes_no_more_than_its_driver_asks(limits: Any) -> None:
    cell, hand = cell_and_hand()
    _, obj = grasp_and_object()
    # A motor that makes 1.2 times the torque that it is asked for.
    truth = draw_twin(0, len(hand.joint_names), 16, replace(IDEAL, stiffness=(1.2, 1.2)))
    largest = []
    for of in (cell, with_options(cell, torque_limits=limits)):
        world = TwinWorld(of, hand, obj, truth)
        world.command_hand(world.finger_positions() + 1.0)
        seen = np.zeros(16)
        for step in range(40):
            world.advance(0.002 * (step + 1))
            seen = np.maximum(seen, np.abs(world.hand_state()[2]))
        largest.append(seen)
    free, limited = largest
    np.testing.assert_allclose(limited, 1.2 * np.broadcast_to(limits, 16), rtol=1e-6)
    assert (free > limited + 0.1).all()
    assert force_limits(limited_hand(with_options(cell, torque_limits=limits), hand)).max() == np.max(limits)


@pytest.mark.parametrize("limits", [0.0, -1.0, "much", [0.1] * 3, [0.1] * 15 + [0.0]])
def test_impossible_limits_are_refused(limits: Any) -> None:
    cell, hand = cell_and_hand()
    with pytest.raises(FungraspError, match="torque_limits"):
        driver_torque_limits(with_options(cell, torque_limits=limits), hand)


def test_a_file_of_dynamics_may_say_the_torques(tmp_path: Path) -> None:
    cell, hand = cell_and_hand()
    path, first = tmp_path / "hand.toml", next(iter(hand.actuators))
    path.write_text(f'[joints."{first}"]\ntorque_limit = 0.31\n')
    found = load_dynamics(path, hand)
    assert found.torque_limit is not None and found.torque_limit[0] == 0.31
    for limited in (identified_hand(hand, path), identified_dynamics(cell, hand, path)[0]):
        np.testing.assert_array_equal(force_limits(limited)[:1], [0.31])
        np.testing.assert_array_equal(force_limits(limited)[1:], force_limits(hand)[1:])
    save_dynamics(tmp_path / "again.toml", found)
    again = load_dynamics(tmp_path / "again.toml", hand).torque_limit
    np.testing.assert_allclose(again, found.torque_limit)
    model: mujoco.MjModel = hand.spec().compile()
    set_dynamics(model, found)
    np.testing.assert_allclose(model.actuator(first).forcerange, [-0.31, 0.31])
    # A driver that sends less has the last word.
    less = with_options(cell, torque_limits=0.2)
    assert force_limits(identified_dynamics(less, hand, path)[0]).max() == 0.2
    # Where the file says nothing of torques, it keeps no place for them.
    save_dynamics(path, model_dynamics(hand))
    assert "torque_limit" not in path.read_text() and load_dynamics(path, hand).torque_limit is None
    path.write_text(f'[joints."{first}"]\ntorque_limit = 0\n')
    with pytest.raises(FungraspError, match="positive"):
        identified_hand(hand, path)
