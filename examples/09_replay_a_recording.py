"""Replays a recorded episode of a nominal world in plain MuJoCo, from what the servos were told."""

from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

import fungrasp
from fungrasp.evaluation import replay
from fungrasp.simulation import build_scene

human = fungrasp.builtin_grasps()
human = human.select(np.flatnonzero(human.object_name == "can")[:1])
objects, hand = fungrasp.load_objects(human), fungrasp.load_hand("allegro")
with TemporaryDirectory() as folder:
    fungrasp.evaluate(fungrasp.retarget(human, objects, hand), objects, record=Path(folder))
    (episode,) = (replay(path) for path in Path(folder).glob("*.npz"))

model = build_scene(hand, objects).model
data = mujoco.MjData(model)
data.qpos[:] = episode.qpos[0]
data.mocap_pos[0], data.mocap_quat[0] = episode.wrist_reference[:3], episode.wrist_reference[3:]
assert episode.controls is not None and not episode.differs
spans = zip(episode.times, episode.times[1:], episode.controls[1:], strict=False)
for before, after, controls in spans:
    data.ctrl[:] = controls
    mujoco.mj_step(model, data, nstep=round((after - before) / model.opt.timestep))

error = np.linalg.norm(data.body("object").xpos - episode.object_pose[-1, :3])
print(
    f"the object ends {1e3 * error:.3f} mm from where it was recorded, {episode.object_pose[-1, 2]:.3f} m up"
)
