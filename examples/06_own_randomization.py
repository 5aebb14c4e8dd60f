"""What may differ between the world and what is believed of it: one description, for tests and training."""

import numpy as np

import fungrasp
from fungrasp.sim2real import ROBUSTNESS, MeasurementError, draw

np.set_printoptions(precision=2)

slippery_and_heavy = fungrasp.Randomization(
    mass=(1.0, 1.5),
    friction=(0.5, 0.9),
    object_position_error=MeasurementError(bias=0.002, jitter=0.001),
    tracker_delay=(0.0, 0.06),
    tracker_dropout=0.1,
)
sample = draw(slippery_and_heavy, count=3, joints=16, rng=np.random.default_rng(0))
print("mass factors:", sample.mass, " tracker delays [s]:", sample.tracker_delay)

human = fungrasp.builtin_grasps()
human = human.select(human.object_name == "can")
objects = fungrasp.load_objects(human)
hand = fungrasp.load_hand("allegro")
robot = fungrasp.retarget(human, objects, hand)

conditions = {"nominal": ROBUSTNESS["nominal"], "own": slippery_and_heavy}
for name, randomization in conditions.items():
    seeds = (0, 1) if randomization.is_random else (0,)
    result = fungrasp.evaluate(
        robot, objects, spec=fungrasp.LiftTestSpec(randomization=randomization, seeds=seeds)
    )
    print(f"{name}: {result.outcomes.success.mean():.0%}")
