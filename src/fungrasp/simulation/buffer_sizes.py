"""How large the buffers of the GPU engine have to be: found by a probe on the processor.

MuJoCo on the CPU takes the memory that a step needs; on a GPU the buffers for contacts and for rows of
constraints are made once. What does not fit is left out, so they are made from what a hand that closes at
random around each of the scene's objects needs, with room to spare.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from fungrasp.simulation.devices import BufferSizes
from fungrasp.simulation.mujoco_cpu import MujocoCpuEngine
from fungrasp.simulation.scene import Scene

HANDS = 8
"""Random hands around each object."""
MOST_WORLDS = 256
"""Of a probe; of more objects, some are tried."""
STEPS = 40
"""Times that the fingers move on, two physics steps each; they are closed after the first half."""
NEAR = 0.06
"""Distance of palm and object [m]: fingers reach it from there."""
SPARE = 2.0
"""Factor on what the probe finds: whole episodes of Allegro had up to 71 contacts and 300 rows, and the probe
finds 40 contacts in all but 1 % of the worlds and up to 304 rows."""


_known: WeakKeyDictionary[Scene, BufferSizes] = WeakKeyDictionary()


def probe_buffer_sizes(scene: Scene) -> BufferSizes:
    """What the hand and the objects of a scene need; it takes about a second, once for each scene."""
    if scene not in _known:
        _known[scene] = _probe(scene)
    return _known[scene]


def _probe(scene: Scene) -> BufferSizes:
    rng = np.random.default_rng(0)
    held = np.repeat(np.arange(len(scene.objects)), HANDS)
    if len(held) > MOST_WORLDS:
        held = rng.permutation(held)[:MOST_WORLDS]
    count, hand = len(held), scene.hand
    engine = MujocoCpuEngine(scene, count, 1)
    engine.set_parameters(object_index=held)
    engine.reset()
    standing = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1))
    standing[:, 2] = [-scene.models[i].vertices[:, 2].min() for i in held]
    away, turn = rng.normal(size=(count, 3)), rng.normal(size=(count, 4))
    away[:, 2] = np.abs(away[:, 2])
    palm = standing.copy()
    palm[:, :3] += NEAR * away / np.linalg.norm(away, axis=1, keepdims=True)
    palm[:, 3:] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    engine.set_state(
        object_pose=standing, wrist_frame=palm, joint_positions=np.zeros((count, len(hand.joint_names)))
    )
    contacts, rows = engine.batch.bind("ncon"), engine.batch.bind("nefc")
    lowest, highest = scene.servo_limits.T
    still, found = np.zeros((count, 3)), []
    for step in range(STEPS):
        closed = lowest + min(1.0, 2 * (step + 1) / STEPS) * (highest - lowest)
        engine.step(engine.controls(palm, still, np.tile(closed, (count, 1))), 2)
        found.append((contacts.copy(), rows.copy()))
    most_contacts, most_rows = np.array(found).transpose(1, 0, 2).reshape(2, -1)
    return BufferSizes(
        contacts=_rounded(SPARE * float(np.percentile(most_contacts, 99)), 16),
        rows=_rounded(SPARE * float(most_rows.max()), 32),
    )


def _rounded(number: float, step: int) -> int:
    return max(step, int(np.ceil(number / step)) * step)
