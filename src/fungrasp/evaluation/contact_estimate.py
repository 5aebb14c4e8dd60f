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
    """Sums over the control steps and links of W episodes, shape [W] each; all zero if the policy estimates
    nothing."""

    contact_hits: np.ndarray
    """True positives: links in contact that are estimated in contact."""
    contact_false_alarms: np.ndarray
    """False positives: links estimated in contact that are not."""
    contact_misses: np.ndarray
    """False negatives: links in contact that are not estimated in contact."""
    force_error_n: np.ndarray
    """Absolute force errors of links in contact [N]."""
    force_n: np.ndarray
    """True forces of links in contact [N]."""

    @classmethod
    def none(cls, count: int) -> ContactEstimates:
        """Create zeros for W episodes without estimates. count: W."""
        return cls(*(np.zeros(count) for _ in fields(cls)))

    def summary(self, which: np.ndarray) -> dict[str, Any] | None:
        """Return precision, recall and F1 of contacts, and for links in contact the mean absolute force error
        and the mean force [N]; None without true or estimated contacts.

        Args:
            which: episodes to include, shape [W] bool.
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
    """Compares a student's estimates with the simulation at every step."""

    def __init__(self, student: StudentPolicy, environment: LiftEnvironment):
        """
        Args:
            student: student whose network estimates contacts and forces.
            environment: simulated worlds.
        """
        self._student, self._environment = student, environment
        self.estimates = ContactEstimates.none(len(environment))
        """Sums so far."""

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
        """Add one step. counted: shape [W] bool; the others: shape [W, L]."""
        e, active = self.estimates, counted[:, None]
        for total, values in (
            (e.contact_hits, said & touching),
            (e.contact_false_alarms, said & ~touching),
            (e.contact_misses, ~said & touching),
            (e.force_error_n, np.where(touching, np.abs(said_forces - forces), 0.0)),
            (e.force_n, np.where(touching, forces, 0.0)),
        ):
            total += np.where(active, values, 0).sum(axis=1)
