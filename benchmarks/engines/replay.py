"""Playing a bundle in some engine, and judging it as the lift test does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from benchmarks.engines.bundle import EpisodeBundle, moved_in_palm
from fungrasp.geometry.poses import compose, invert, relative, rotate, rotation_vector
from fungrasp.task import LiftProtocol
from fungrasp.task.outcome import lifted_and_held

SETTLE = 0.5
"""Time in which the object comes to rest anew with the hand at its start [s]."""
GONE = 0.02
"""Height above the table at which an object counts as lost after the hold has begun [m]; the rest is not
played."""
MOVED = 0.002, float(np.deg2rad(3.0))
"""How far an object may settle from where it was [m, rad] to count as in the same place."""
PUSHED = 0.01
"""Displacement of the object in the palm at the lift from where it was [m] that counts as another grasp."""


class EpisodeWorld(Protocol):
    """An episode's hand and object in some engine, at rest at the start."""

    def tell(self, setpoints: np.ndarray) -> None:
        """Give the servos their setpoints, shape [J]."""
        ...

    def advance(self, duration: float) -> None:
        """Let time pass [s]."""
        ...

    def object_pose(self) -> np.ndarray:
        """World frame, shape [7]."""
        ...

    def palm_pose(self) -> np.ndarray:
        """World frame, shape [7]."""
        ...

    def touching(self) -> tuple[frozenset[str], bool]:
        """Bodies of the hand that touch the object, and whether the table does."""
        ...


@dataclass(frozen=True)
class Replayed:
    """What came of an episode in another engine."""

    name: str
    """Of the recording."""
    object_name: str
    """Name of the object."""
    recorded: bool
    """Whether the object was held when it was recorded; of a use test, whether it stayed in the palm."""
    success: bool
    """Whether it was held here."""
    reason: str
    """Why not; "" on success."""
    slip_mm_s: float
    """Path of the object in the palm per second of the hold [mm/s]."""
    recorded_slip_mm_s: float
    """When it was recorded."""
    settled_mm: float
    """How far the object settled from where it was recorded [mm]."""
    difference: str
    """What differed first from the recording; "" where both ended alike."""


def play_bundle(bundle: EpisodeBundle, world: EpisodeWorld, protocol: LiftProtocol | None = None) -> Replayed:
    """Give the setpoints one after the other, and judge what happens.

    Args:
        bundle: of the episode.
        world: made from it.
        protocol: with the height of success; the published one if None.
    """
    p = protocol or LiftProtocol()
    before = relative(world.palm_pose(), np.array(bundle.object_pose))
    world.tell(bundle.told[0])
    world.advance(SETTLE)
    settled = world.object_pose()
    start = relative(world.palm_pose(), settled)
    objects, palms, contacts, table = [], [], [], []
    for number, setpoints in enumerate(bundle.told[1:]):
        world.tell(setpoints)
        world.advance(bundle.period)
        touching, on_table = world.touching()
        objects.append(world.object_pose())
        palms.append(world.palm_pose())
        contacts.append([any(member in touching for member in link) for link in bundle.links])
        table.append(on_table)
        now = bundle.period * (number + 1)
        if not bundle.use and 0 <= bundle.hold_time < now - 0.1 and objects[-1][2] - settled[2] < GONE:
            break
    seen, touched = np.array(objects), np.array(contacts)
    in_palm = compose(invert(np.array(palms)), seen)
    if bundle.use:
        # What does not come to rest in the hand is lost, what does is judged from there.
        reason = moved_in_palm(before, start[None], bundle.center)
        reason = reason or moved_in_palm(start, in_palm, bundle.center)
        success = not reason
    else:
        success, reason = _judged(bundle, settled, seen, touched, np.array(table), p)
    size = float(np.linalg.norm(settled[:3] - np.array(bundle.object_pose)[:3]))
    difference = "" if success == bundle.success else _difference(bundle, settled, in_palm, touched)
    return Replayed(
        name=bundle.name,
        object_name=bundle.object_name,
        recorded=bundle.success,
        success=success,
        reason=reason,
        slip_mm_s=_slip(bundle, in_palm),
        recorded_slip_mm_s=_slip(bundle, np.array(bundle.poses_in_palm)),
        settled_mm=1e3 * size,
        difference=difference,
    )


def _holding(bundle: EpisodeBundle, states: int) -> np.ndarray:
    """Which states are of the hold, shape [states] bool."""
    times = bundle.period * np.arange(1, states + 1)
    return (times > bundle.hold_time - 1e-6) & (bundle.hold_time >= 0)


def _judged(
    bundle: EpisodeBundle,
    settled: np.ndarray,
    objects: np.ndarray,
    contacts: np.ndarray,
    table: np.ndarray,
    protocol: LiftProtocol,
) -> tuple[bool, str]:
    hold = _holding(bundle, len(objects))
    if not hold.any():
        return False, "there was no hold"
    rise = _height(bundle, objects) - _height(bundle, settled[None])
    lowest, touching = rise[hold].min(), contacts[hold].any(axis=1).mean()
    one = np.array([lowest]), np.array([touching]), np.array([table[hold].any()])
    if bool(lifted_and_held(*one, protocol)[0]):
        return True, ""
    if lowest >= protocol.success_height:
        return False, "the object touched the table during the hold"
    if touching > 0.9:
        return False, "held too low"
    return False, "dropped during the hold" if touching > 0 else "lost before the hold"


def _height(bundle: EpisodeBundle, poses: np.ndarray) -> np.ndarray:
    """Of the center of mass [m], shape [N]. poses: shape [N, 7]."""
    return poses[:, 2] + rotate(poses[:, 3:], bundle.center)[:, 2]


def _slip(bundle: EpisodeBundle, in_palm: np.ndarray) -> float:
    """Path in the palm per second of the hold, sampled every 0.1 s [mm/s]; 0 without a hold."""
    every = max(round(0.1 / bundle.period), 1)
    kept = np.flatnonzero(_holding(bundle, len(in_palm)))[::every]
    if len(kept) < 2:
        return 0.0
    path = np.linalg.norm(np.diff(in_palm[kept, :3], axis=0), axis=1).sum()
    return float(1e3 * path / ((len(kept) - 1) * every * bundle.period))


def _difference(bundle: EpisodeBundle, settled: np.ndarray, in_palm: np.ndarray, contacts: np.ndarray) -> str:
    """What differed first from the recording, in words."""
    start = np.array(bundle.object_pose)
    away = np.linalg.norm(settled[:3] - start[:3])
    turned = np.linalg.norm(rotation_vector(compose(invert(start), settled)[3:]))
    if away > MOVED[0] or turned > MOVED[1]:
        return "the object came to rest elsewhere"
    if bundle.lift_time < 0:
        return "there was no lift"
    lift = min(round(bundle.lift_time / bundle.period), len(in_palm) - 1, len(bundle.contacts) - 1)
    there = np.array(bundle.poses_in_palm)
    if np.linalg.norm(in_palm[lift, :3] - there[lift, :3]) > PUSHED:
        return "the closing hand moved the object elsewhere"
    before = np.array(bundle.contacts)[lift].sum() - contacts[lift].sum()
    if before >= 2:
        return "fewer links touched as the lift began"
    return "it slipped" if bundle.success else "it did not slip"
