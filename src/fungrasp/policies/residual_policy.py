"""A trained policy at work: follows the reference, looks at the worlds, corrects."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fungrasp.errors import FungraspError
from fungrasp.objects import ObjectModel
from fungrasp.planning.references import References
from fungrasp.policies.checkpoint.card import PolicyCard
from fungrasp.policies.checkpoint.checkpoint_file import check_fits
from fungrasp.policies.checkpoint.network import PolicyNetwork
from fungrasp.policies.plan_tracking import SensorNoise, Tracker
from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.policies.scripted import planned
from fungrasp.task import Action, LiftTask
from fungrasp.task.observation import flatten, layout, observe, privileged

ACTION_PARTS = ("position", "rotation", "fingers")
"""Parts of a residual action, with the scales of ``ResidualSettings``."""


class LearnedPolicy:
    """Acts in W worlds with a network from a policy file."""

    def __init__(
        self,
        task: LiftTask,
        objects: Mapping[str, ObjectModel],
        network: PolicyNetwork,
        references: References | None = None,
        noise: SensorNoise | None = None,
    ):
        """
        Args:
            task: reset; the grasps come from it.
            objects: by name.
            network: made for the task's hand.
            references: to follow, one for each world; those of the task's grasps if None.
            noise: of the sensors; none if None.

        Raises:
            FungraspError: the network was made for another hand, other observations or another rate.
        """
        check_card(network.card, task)
        self._network, hand = network, task.scene.hand
        if references is None:
            references = References.of(planned(task, objects), task.grasps, task.settled_pose, hand)
        self._tracker = Tracker(task, objects, references, residual_settings(network.card), noise)
        everyone = np.arange(len(task.worlds))
        self._tracker.begin(everyone, everyone)
        self._sees_contacts = bool(network.card.privileged)
        check_fits(
            network.card,
            hand,
            layout(self._seen()),
            layout(self._contacts()),
            1 / task.protocol.control_period,
        )
        self._state = network.initial_state(len(everyone))
        self._first = True

    def act(self) -> Action:
        """What to do in the next control period."""
        if not self._first:
            self._tracker.advance()
        self._first = False
        seen = flatten(self._seen() | (self._contacts() if self._sees_contacts else {}))
        # A finished or broken world may hold anything; its action is not used.
        finite = np.where(np.isfinite(seen), seen, 0.0).astype(np.float32)
        action, _, self._state = self._network(finite, self._state)
        return self._tracker.act(action)

    def _seen(self) -> dict[str, np.ndarray]:
        """What a robot has."""
        view = self._tracker.view()
        return observe(view.now, view.before, view.wanted, view.action)

    def _contacts(self) -> dict[str, np.ndarray]:
        """What only a teacher sees."""
        sensed = self._tracker.sensed()
        return privileged(sensed.contacts, sensed.forces, self._tracker.view().wanted.contacts)


def check_card(card: PolicyCard, task: LiftTask) -> None:
    """What can be checked before anything is planned for a policy.

    Raises:
        FungraspError: it was made for another hand, another rate or other actions.
    """
    own = tuple((part.name, part.size) for part in card.observation)
    contacts = tuple((part.name, part.size) for part in card.privileged)
    check_fits(card, task.scene.hand, own, contacts, 1 / task.protocol.control_period)
    residual_settings(card)


def residual_settings(card: PolicyCard) -> ResidualSettings:
    """Those that a policy was trained with.

    Raises:
        FungraspError: its action has other parts.
    """
    scales = {part.name: part.scale for part in card.action}
    if tuple(scales) != ACTION_PARTS:
        raise FungraspError(
            f"policy '{card.name}' has the actions {', '.join(scales)}, not {', '.join(ACTION_PARTS)}"
        )
    return ResidualSettings(**scales, smoothing=card.action_smoothing)
