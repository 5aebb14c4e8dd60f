"""Accuracy of a student's contact estimates, compared with the simulation."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.policies import StudentPolicy
from fungrasp.task import Action, GraspPlan, LiftEnvironment, Observation
from fungrasp.task.features import unscaled_forces


@dataclass(frozen=True, eq=False, repr=False)
class ContactEstimates(BatchRecord):
    """Sums over the control steps and links of W episodes, a number each, shape [W]; all zero where nothing
    was estimated."""

    contact_hits: np.ndarray
    """True positives: links in contact and estimated so."""
    contact_false_alarms: np.ndarray
    """False positives: links estimated in contact that are not."""
    contact_misses: np.ndarray
    """False negatives: links in contact, not estimated so."""
    force_error_n: np.ndarray
    """Absolute force errors of links in contact [N]."""
    force_n: np.ndarray
    """True forces of links in contact [N]."""

    @classmethod
    def none(cls, count: int) -> ContactEstimates:
        """Of episodes in which nothing is estimated. count: W."""
        return cls(*(np.zeros(count) for _ in fields(cls)))

    def summary(self, which: np.ndarray) -> dict[str, Any] | None:
        """Precision, recall and F1 of the contact states, mean absolute error of the forces of links that
        touch and mean of these forces [N]; None where nothing touches or is said to.

        Args:
            which: episodes that count, shape [W] bool.
        """
        hits, alarms, misses, error, force = (getattr(self, f.name)[which].sum() for f in fields(self))
        if hits + alarms + misses == 0:
            return None
        touching = max(hits + misses, 1)
        return {
            "precision": float(hits / max(hits + alarms, 1)),
            "recall": float(hits / touching),
            "f1": float(2 * hits / (2 * hits + alarms + misses)),
            "force_error_n": float(error / touching),
            "force_n": float(force / touching),
        }


class ContactEstimateMeter:
    """A wrapper that compares a student's estimates with the truth at every step."""

    def __init__(self, student: StudentPolicy, environment: LiftEnvironment):
        """
        Args:
            student: whose network says contacts and forces.
            environment: with the truth.
        """
        self._student, self._environment = student, environment
        self.estimates = ContactEstimates.none(len(environment))
        """What was counted so far."""

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        """See ``Policy.reset``."""
        self._student.reset(plan, observation)

    def act(self, observation: Observation) -> Action:
        """See ``Policy.act``."""
        action = self._student.act(observation)
        outputs, engine = self._student.outputs, self._environment.engine
        self._count(
            outputs["contacts"] > 0.5,
            unscaled_forces(outputs["forces"].astype(float)),
            engine.link_contacts,
            engine.link_forces,
            ~self._environment.task.done & ~engine.diverged,
        )
        return action

    def _count(
        self,
        said: np.ndarray,
        said_forces: np.ndarray,
        touching: np.ndarray,
        forces: np.ndarray,
        counted: np.ndarray,
    ) -> None:
        """Add one step. All but the last of shape [W, L]; counted: shape [W] bool."""
        e, active = self.estimates, counted[:, None]
        for total, values in (
            (e.contact_hits, said & touching),
            (e.contact_false_alarms, said & ~touching),
            (e.contact_misses, ~said & touching),
            (e.force_error_n, np.where(touching, np.abs(said_forces - forces), 0.0)),
            (e.force_n, np.where(touching, forces, 0.0)),
        ):
            total += np.where(active, values, 0).sum(axis=1)
