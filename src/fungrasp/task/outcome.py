"""Success criteria and other measurements during the hold (docs/evaluate.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fungrasp.core.records import BatchRecord
from fungrasp.geometry.arrays import at_least, may_be_any, rows_like
from fungrasp.geometry.poses import Array, array_namespace, compose, invert, relative, stack
from fungrasp.grasps.as_shown import AsShown, ShownContacts, ShownJudge
from fungrasp.simulation import Engine
from fungrasp.task.protocol import LiftProtocol

PARKED = np.array([0.0, 0.0, 3.0, 1.0, 0.0, 0.0, 0.0])
"""Pose of a palm far from any object."""

DIVERGED = "the simulation diverged"
"""Reason of failure if the simulation became unstable."""


@dataclass(frozen=True, eq=False, repr=False)
class Outcomes(BatchRecord):
    """Outcomes of W episodes; all arrays have shape [W]."""

    success: np.ndarray
    """Whether the object stayed up, touching only the hand, during the whole hold, bool."""
    lifted_height_m: np.ndarray
    """Smallest height of the center of mass above its settled height during the hold [m]."""
    contact_ratio: np.ndarray
    """Share of the target links in contact, mean over the hold."""
    contact_precision: np.ndarray
    """Share of the links in contact that are targets, mean over the hold; zero without contact."""
    contact_f1: np.ndarray
    """Harmonic mean of the two at each sample, mean over the hold."""
    sim_distance_world_mm_s: np.ndarray
    """Displacement of the object per second of the hold, world frame [mm/s]; a dropped object counts until it
    rests."""
    sim_distance_hand_mm_s: np.ndarray
    """The same relative to the palm: slip [mm/s]."""
    pushed_m: np.ndarray
    """Displacement of the object in the table's plane before the lift [m]."""
    legacy_success: np.ndarray
    """Whether the object did not touch the table during the hold, at any height, bool: the definition of
    earlier published code."""
    reason: np.ndarray
    """Why the episode failed, "" on success, str."""
    held_as_shown: np.ndarray
    """Whether the object was held as the person held it (``grasps.as_shown``), bool; false if the person's
    contacts are unknown."""
    shown_share: np.ndarray
    """Share of the target finger links that touch as shown in the middle of the hold; NaN if unknown."""
    place_error_mm: np.ndarray
    """Mean distance of these links' contacts from the person's [mm]; NaN if unknown."""
    other_side: np.ndarray
    """Share of these links on another side of the object than the person's contact; NaN if unknown."""
    strays: np.ndarray
    """Number of links that touch far from all contacts of the person; NaN if unknown."""
    not_as_shown: np.ndarray
    """Why a held object was not held as shown; "" otherwise, str."""

    def fail(self, which: np.ndarray, reason: str) -> None:
        """Mark episodes as failed. which: shape [W] bool; reason: stored for those marked as successful."""
        self.reason[which & self.success] = reason
        self.success[which] = self.held_as_shown[which] = False
        self.not_as_shown[which] = ""


@dataclass(frozen=True, eq=False, repr=False)
class HoldMiddle(BatchRecord):
    """State of W episodes in the middle of the hold; NaN before it."""

    palm_pose: np.ndarray
    """Palm pose, object frame, shape [W, 7]."""
    joint_positions: np.ndarray
    """Positions of all joints [rad], shape [W, M]."""
    touching: np.ndarray
    """Links that touched for more than half of the hold, palm first, shape [W, L] bool."""

    def as_shown(self, judge: ShownJudge, shown: ShownContacts) -> AsShown:
        """Judge whether the grasps are held as shown. Episodes without a hold count as hands far from the
        object. shown: the person's contacts, W rows."""
        reached = np.isfinite(self.palm_pose[:, :1])
        palm = np.where(reached, self.palm_pose, PARKED)
        joints = np.where(reached, self.joint_positions, 0.0)
        return judge(palm, joints, shown, self.touching[:, 1:] & reached)


def lifted_and_held(
    lowest: np.ndarray, in_hand: np.ndarray, touched: np.ndarray, protocol: LiftProtocol
) -> np.ndarray:
    """Return whether lifts succeeded, in simulation or on a twin: during the whole hold, the object stayed
    up, in the hand, and touched nothing else.

    Args:
        lowest: smallest height of the object's center of mass above its settled height during the hold [m],
            shape [W].
        in_hand: share of the hold's samples in which the object touches the hand, shape [W]; excludes thrown
            objects.
        touched: whether the object touched anything else during the hold, shape [W] bool.
        protocol: protocol with the success height.

    Returns:
        Shape [W] bool.
    """
    return (lowest >= protocol.success_height) & (in_hand > 0.5) & ~touched


class LiftMeasurements:
    """Accumulates measurements for the outcomes of W episodes."""

    def __init__(self, engine: Engine, protocol: LiftProtocol, period: float):
        """
        Args:
            period: time between two calls of ``watch`` [s].
        """
        self._period = period
        count, on = len(engine), engine.object_pose
        self._engine, self._protocol = engine, protocol
        none = rows_like(on, np.zeros(count, dtype=bool))
        self.settled_height = rows_like(on, np.zeros(count))
        """Height of the objects' centers of mass at rest, world frame [m], shape [W]."""
        self._lifted = rows_like(on, np.full(count, np.inf))
        self._touched_table = none
        self._pushed = rows_like(on, np.zeros(count))
        # Rows: number of samples, recall, precision, F1, any contact, intervals, travel in the world, travel
        # in the palm. There is one interval fewer than samples: the first sample ends the lift.
        self._sums = rows_like(on, np.zeros((8, count)))
        self._held = rows_like(on, np.zeros(count, dtype=bool))
        links, joints = len(engine.scene.hand.links), engine.joint_positions.shape[1]
        # Number of states in the hold, number of those with contact of each link, and the middle state.
        self._states = rows_like(on, np.zeros(count))
        self._touched = rows_like(on, np.zeros((count, links)))
        self._middle_palm = rows_like(on, np.full((count, 7), np.nan))
        self._middle_joints = rows_like(on, np.full((count, joints), np.nan))
        unknown = np.full((count, 3), np.nan)
        self._previous = rows_like(on, unknown), rows_like(on, unknown)

    @property
    def height(self) -> Array:
        """Height of the objects' centers of mass above their settled height [m], -1 if the simulation
        diverged, shape [W]."""
        height = self._engine.center_of_mass[:, 2] - self.settled_height
        xp = array_namespace(height)
        return xp.where(xp.isfinite(height) & ~self._engine.diverged, height, -1.0)

    def begin(self, ids: np.ndarray) -> None:
        """Reset the measurements of some worlds whose objects are at rest. ids: shape [I]."""
        self.settled_height[ids] = self._engine.center_of_mass[ids, 2]
        self._lifted[ids] = np.inf
        self._touched_table[ids] = False
        self._pushed[ids] = 0.0
        self._sums[:, ids] = 0.0
        self._held[ids] = False
        self._states[ids] = self._touched[ids] = 0.0
        self._middle_palm[ids] = self._middle_joints[ids] = np.nan
        self._previous[0][ids], self._previous[1][ids] = np.nan, np.nan

    def lift_begins(self, which: np.ndarray, settled_pose: np.ndarray) -> None:
        """Measure how far the objects were pushed before the lift.

        Args:
            which: worlds in which the lift begins, shape [W] bool.
            settled_pose: rest poses of the objects, world frame, shape [W, 7].
        """
        moved = _lengths(self._engine.object_pose[:, :2] - settled_pose[:, :2])
        self._pushed = array_namespace(moved).where(which, moved, self._pushed)

    def watch(self, holding: np.ndarray, hold_time: np.ndarray) -> None:
        """Update height, table contact, link contacts and the middle state after each setpoint.

        Args:
            holding: worlds in their hold, shape [W] bool.
            hold_time: start of the hold [s], shape [W].
        """
        if not may_be_any(holding):
            return
        engine, p = self._engine, self._protocol
        xp = array_namespace(self._lifted)
        self._lifted = xp.where(holding, xp.minimum(self._lifted, self.height), self._lifted)
        self._touched_table |= holding & engine.object_on_table
        # A hold ends with the control period in which its time is over.
        began = xp.where(holding, hold_time, 0.0)
        end = p.control_period * xp.ceil((began + p.hold_time - 1e-9) / p.control_period)
        number = xp.round((end - began) / self._period) + 1
        middle = holding & (self._states == xp.floor(number / 2))
        self._states = self._states + xp.where(holding, 1.0, 0.0)
        self._touched = self._touched + xp.where(holding[:, None] & engine.link_contacts, 1.0, 0.0)
        if may_be_any(middle):
            palm = relative(engine.object_pose, engine.palm_pose)
            self._middle_palm = xp.where(middle[:, None], palm, self._middle_palm)
            self._middle_joints = xp.where(middle[:, None], engine.joint_positions, self._middle_joints)

    def sample(self, holding: np.ndarray, target: np.ndarray) -> None:
        """Update contact ratios and displacements after each control period.

        Args:
            holding: worlds in their hold, shape [W] bool.
            target: links that should touch, shape [W, L] bool.
        """
        position, palm = self._engine.object_pose, self._engine.palm_pose
        in_palm = compose(invert(palm), position)[:, :3]
        actual = self._engine.link_contacts
        xp = array_namespace(position)
        one = xp.ones_like(position[:, 0])
        wanted, touching = (xp.sum(flags * one[:, None], axis=1) for flags in (target, actual))
        both = xp.sum((actual & target) * one[:, None], axis=1)
        recall, precision = (both / xp.where(n > 0, n, one) for n in (wanted, touching))
        f1 = 2 * both / xp.where(wanted + touching > 0, wanted + touching, one)
        travel = _lengths(position[:, :3] - self._previous[0])
        slip = _lengths(in_palm - self._previous[1])
        contacts = stack(one, recall, precision, f1, xp.where(touching > 0, one, 0.0))
        moved = stack(one, travel, slip)
        self._sums[:5] += xp.where(holding, contacts, 0.0)
        self._sums[5:] += xp.where(holding & self._held & xp.isfinite(moved), moved, 0.0)
        self._previous, self._held = (position[:, :3], in_palm), holding

    @property
    def success(self) -> Array:
        """Whether the episodes would succeed if their hold ended now, shape [W] bool."""
        held = self._sums[4] / at_least(self._sums[0], 1)
        return lifted_and_held(self._lifted, held, self._touched_table, self._protocol)

    @property
    def middle(self) -> HoldMiddle:
        """State in the middle of the hold."""
        touched = self._touched > 0.5 * self._states[:, None]
        return HoldMiddle(self._middle_palm, self._middle_joints, touched)

    def outcomes(self, shown: AsShown | None = None) -> Outcomes:
        """Return the measurements so far. shown: whether grasps are held as shown, W rows; None if the
        person's contacts are unknown."""
        number, recall, precision, f1, touching, intervals, travel, slip = self._sums
        number = np.maximum(number, 1)
        high = self._lifted >= self._protocol.success_height
        diverged = self._lifted < -0.5
        in_hand = touching / number > 0.5
        success = self.success
        reason = np.select(
            [success, diverged, high & in_hand, touching / number > 0.9, touching > 0],
            [
                "",
                DIVERGED,
                "the object touched the table during the hold",
                "held too low",
                "dropped during the hold",
            ],
            "lost before the hold",
        )
        unknown = np.full(len(success), np.nan)
        per_second = 1e3 / (np.maximum(intervals, 1) * self._protocol.control_period)
        return Outcomes(
            success=success,
            lifted_height_m=self._lifted,
            contact_ratio=recall / number,
            contact_precision=precision / number,
            contact_f1=f1 / number,
            sim_distance_world_mm_s=travel * per_second,
            sim_distance_hand_mm_s=slip * per_second,
            pushed_m=self._pushed,
            legacy_success=~self._touched_table & ~diverged,
            reason=reason,
            held_as_shown=success & (False if shown is None else shown.holds),
            shown_share=unknown if shown is None else shown.share,
            place_error_mm=unknown if shown is None else 1e3 * shown.place_error,
            other_side=unknown if shown is None else shown.other_side,
            strays=unknown if shown is None else shown.strays,
            not_as_shown=np.where(success, "" if shown is None else shown.reason, ""),
        )


def _lengths(vectors: Array) -> Array:
    xp = array_namespace(vectors)
    return xp.sqrt(xp.sum(vectors * vectors, axis=1))
