"""Page of plans: the planned motion without physics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.geometry.poses import compose
from fungrasp.hands import Hand, load_hand
from fungrasp.objects import ObjectModel
from fungrasp.task import GraspPlan, LiftProtocol
from fungrasp.viewer.episode_stage import (
    EpisodePlayer,
    EpisodeScene,
    EpisodeState,
    EpisodeStates,
    place_in_front,
)
from fungrasp.viewer.page import BrowserPage, add_table, look_at

if TYPE_CHECKING:
    from viser import ClientHandle

LIFT_STEPS = 10
"""Number of control steps of the displayed lift, which is not part of a plan."""


def planned_states(plans: GraspPlan, row: int, hand: Hand) -> EpisodeStates:
    """Return the states of a plan at each control step, and of the lift: palm and fingers at their setpoints,
    the object at rest until it is lifted."""
    states, rest = EpisodeStates(), plans.object_pose[row]
    palms = compose(rest[None], plans.palm_setpoint_object[row])
    goals = compose(rest[None], plans.palm_goal_object[row])
    lift, touching = int(plans.lift_step[row]), plans.link_contacts[row]
    for step in range(lift + LIFT_STEPS + 1):
        at, up = min(step, lift), np.zeros(7)
        up[2] = LiftProtocol.lift_height * max(step - lift, 0) / LIFT_STEPS
        joints = hand.all_joints(plans.finger_targets[row, max(at - 1, 0)])
        states.add(
            EpisodeState(
                time=step * plans.control_period,
                phase="lift" if step > lift else "approach",
                object_pose=rest + up,
                palm_pose=palms[at] + up,
                joints=joints,
                contacts=touching if step >= lift else np.zeros_like(touching),
                commanded_palm=goals[at] + up,
                commanded_joints=joints,
            )
        )
    return states


class PlanPage(BrowserPage):
    """Page to select a plan, scrub through its motion and replay it."""

    def __init__(self, client: ClientHandle, plans: GraspPlan, objects: Mapping[str, ObjectModel]):
        super().__init__(client)
        self._plans, self._objects, self._hand = plans, objects, load_hand(plans.hand)
        add_table(client)
        client.gui.add_markdown(f"**{self._hand.title}**, planned, not simulated")
        labels = [f"{row}: {name}" for row, name in enumerate(plans.object_name.tolist())]
        self._row = client.gui.add_dropdown("Plan", labels)
        self._player = EpisodePlayer(self)
        self._row.on_update(lambda _: self.worker.ask("show", self._show))
        self.worker.ask("show", self._show)

    def _show(self) -> None:
        row = int(self._row.value.partition(":")[0])
        plans, model = self._plans, self._objects[str(self._plans.object_name[row])]
        look_at(self.client, (0.0, 0.0, 0.12), 0.75)
        with self.client.atomic():
            place = place_in_front(plans.object_pose[row])
            scene = EpisodeScene(self.client.scene, f"/plan{row}", place, self._hand, model)
        self._player.begin(scene, planned_states(plans, row, self._hand))
        self._player.finish()
        expected = (
            "" if plans.expected_success is None else f"expected success {plans.expected_success[row]:.0%}"
        )
        self._player.status.content = expected
