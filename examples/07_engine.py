"""Worlds stepped through the engine's door: state and parameters in, state and contacts out."""

import numpy as np

import fungrasp
from fungrasp.simulation import MujocoCpuEngine

names = ("can", "mug", "can")
hand = fungrasp.load_hand("allegro")
objects = {name: fungrasp.load_object(name) for name in names}
scene = fungrasp.build_scene(hand, objects)
engine: fungrasp.Engine = MujocoCpuEngine(scene, len(names))

# Another object and mass in each world; they fall from 2 cm, the hand waits above.
engine.set_parameters(
    object_index=scene.indices(list(names)), object_mass=np.array([0.3, 0.4, 0.6]), friction=np.full(3, 0.7)
)
engine.reset()
above = np.tile([0.0, 0.0, 0.12, 1.0, 0.0, 0.0, 0.0], (3, 1))
palm = np.tile([0.0, 0.0, 0.6, 1.0, 0.0, 0.0, 0.0], (3, 1))
engine.set_state(object_pose=above, wrist_frame=palm)

fingers = hand.independent(engine.joint_positions)
controls = engine.controls(palm, np.zeros((3, 3)), fingers)
for _ in range(5):
    engine.step(controls, steps=20)
    heights = engine.center_of_mass[:, 2]
    print("heights [m]:", heights.round(3), " on the table:", engine.object_on_table)

# A snapshot; what follows is repeated to the last bit.
state = engine.get_state()
engine.step(controls, steps=20)
once = engine.object_pose
engine.restore(state)
engine.step(controls, steps=20)
assert np.array_equal(engine.object_pose, once)
