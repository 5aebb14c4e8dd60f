"""Learned policies, which correct a plan from observations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.hands import Hand
from fungrasp.objects import ObjectModel
from fungrasp.policies.checkpoint.card import PolicyCard
from fungrasp.policies.checkpoint.checkpoint_file import PolicyNetwork, check_fits
from fungrasp.policies.plan_tracking import PlanTracker
from fungrasp.policies.residual_action import Base, ResidualSettings
from fungrasp.task import Action, GraspPlan, Observation, Privileged
from fungrasp.task.features import contact_features, layout, network_input, network_parts

ACTION_PARTS: Mapping[Base, tuple[str, str, str]] = {
    "plan": ("position", "rotation", "fingers"),
    "guided": ("position_from_grasp", "rotation_from_grasp", "fingers_step"),
}
"""Names of the parts of a residual action, with the scales of ``ResidualSettings``, by base."""


class _ResidualNetwork:
    """Base of students and teachers."""

    def __init__(self, network: PolicyNetwork, hand: Hand, objects: Mapping[str, ObjectModel]):
        """
        Raises:
            FungraspError: the network is for another hand or other actions.
        """
        check_card(network.card, hand)
        self.network, self._hand, self._objects = network, hand, objects
        self._settings = residual_settings(network.card)
        self._remembers = bool(network.initial_state(0))

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        """See ``Policy.reset``.

        Raises:
            FungraspError: the network is for other observations or another rate.
        """
        everyone = np.arange(len(observation))
        self._tracker = PlanTracker(self._hand, self._objects, plan, len(everyone), self._settings)
        self._tracker.begin(everyone, everyone, observation)
        seen = layout(self._seen())
        none = np.zeros(plan.link_contacts.shape)
        contacts = layout(contact_features(none, none, plan.link_contacts))
        check_fits(self.network.card, self._hand, seen, contacts, 1 / plan.control_period)
        self._memory = self.network.initial_state(len(everyone))

    def _seen(self) -> dict[str, np.ndarray]:
        """Return the network's inputs from robot sensors."""
        features = self._tracker.state().robot_features()
        return network_parts(features, self.network.card.layout_name, encoder=self._remembers)

    def _act(self, observation: Observation, contacts: Mapping[str, np.ndarray]) -> Action:
        self._tracker.update(observation)
        seen = network_input({**self._seen(), **contacts})
        # Finished or diverged worlds may contain NaN; their actions are not used.
        finite = np.where(np.isfinite(seen), seen, np.float32(0.0))
        action, self.outputs, self._memory = self.network(finite, self._memory)
        return self._tracker.act(action)


class StudentPolicy(_ResidualNetwork):
    """A policy that uses only robot sensors. ``outputs`` has the network's other outputs at the last step:
    estimated contacts and forces."""

    outputs: Mapping[str, np.ndarray]

    @property
    def estimates_contacts(self) -> bool:
        """Whether the network estimates contacts and forces."""
        return {"contacts", "forces"} <= set(self.network.outputs)

    def act(self, observation: Observation) -> Action:
        """See ``Policy.act``."""
        return self._act(observation, {})


class TeacherPolicy(_ResidualNetwork):
    """A policy that also uses true contacts, which exist only in simulation."""

    def act_privileged(self, observation: Observation, privileged: Privileged) -> Action:
        """See ``PrivilegedPolicy.act_privileged``."""
        targets = self._tracker.plans.link_contacts
        return self._act(observation, contact_features(privileged.contacts, privileged.forces, targets))


def residual_policy(
    network: PolicyNetwork, hand: Hand, objects: Mapping[str, ObjectModel]
) -> StudentPolicy | TeacherPolicy:
    """Make a learned policy: a teacher if its network has privileged inputs, else a student.

    Raises:
        FungraspError: the network is for another hand or other actions.
    """
    kind = TeacherPolicy if network.card.privileged else StudentPolicy
    return kind(network, hand, objects)


def check_card(card: PolicyCard, hand: Hand) -> None:
    """Check a policy as far as possible before planning.

    Raises:
        FungraspError: the policy is for another hand or other actions.
    """
    own = tuple((part.name, part.size) for part in card.observation)
    contacts = tuple((part.name, part.size) for part in card.privileged)
    check_fits(card, hand, own, contacts, card.rate_hz)
    residual_settings(card)


def residual_settings(card: PolicyCard) -> ResidualSettings:
    """Return the settings that a policy was trained with.

    Raises:
        FungraspError: the policy has other actions.
    """
    scales = {part.name: part.scale for part in card.action}
    for base, names in ACTION_PARTS.items():
        if tuple(scales) == names:
            return ResidualSettings(base, *scales.values(), smoothing=card.action_smoothing)
    raise FungraspError(
        f"policy '{card.name}' has the actions {', '.join(scales)}, not "
        + " or ".join(", ".join(names) for names in ACTION_PARTS.values())
    )
