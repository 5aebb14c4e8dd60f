"""The lift test through its public door: results, records, resuming, policies of one's own."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from small_parts import evaluate_in_parts

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.jobs import PartStore
from fungrasp.evaluation import LiftTestResult, LiftTestSpec, evaluate, replay, result_json
from fungrasp.geometry.poses import compose
from fungrasp.hands import load_hand
from fungrasp.planning import MotionPlanner
from fungrasp.policies import OpenLoopPolicy
from fungrasp.sim2real import Randomization
from fungrasp.task import Action, GraspPlan, LiftProtocol, Observation


@pytest.fixture(scope="module")
def recorded(good, things, allegro, tmp_path_factory):
    """A result and the folder its episodes were recorded to."""
    folder = tmp_path_factory.mktemp("trials")
    return evaluate(good, things, record=folder), folder


def same(a: LiftTestResult, b: LiftTestResult) -> bool:
    ours, theirs = a.outcomes.arrays(), b.outcomes.arrays()
    return all(np.array_equal(value, theirs[name]) for name, value in ours.items())


def test_good_grasps_succeed_and_nothing_depends_on_threads_or_chunks(recorded, good, things, allegro):
    result, _ = recorded
    assert result.outcomes.success.sum() >= 3
    done = []
    other = evaluate_in_parts(3, good, things, threads=1, progress=done.append)
    assert same(result, other)
    assert done == sorted(done) and done[-1] == 1 and 0 <= done[0] < 0.75


def test_the_json_has_every_number_and_they_agree(recorded):
    result, _ = recorded
    numbers = json.loads(json.dumps(result_json(result), allow_nan=False))
    assert numbers["hand"] == "allegro" and numbers["policy"] == "reference" and numbers["seed"] == 0
    assert (
        numbers["lift_test"]["hold_time"] == 3.0
        and numbers["protocol"] == "nominal"
        and numbers["randomization"]["mass"] == [1.0, 1.0]
    )
    trials = numbers["trials"]
    assert [trial["index"] for trial in trials] == [0, 1, 2, 3]
    assert {"object", "task", "success", "lifted_height_m", "reason", "contact_f1"} <= set(trials[0])
    rate = np.mean([trial["success"] for trial in trials])
    assert numbers["success_rate"] == rate and numbers["unstable"] == 0
    low, high = numbers["success_interval"]
    assert 0 <= low <= rate <= high <= 1
    assert numbers["contact_ratio"] == pytest.approx(np.mean([trial["contact_ratio"] for trial in trials]))
    can = [trial for trial in trials if trial["object"] == "can"]
    assert numbers["by_object"]["can"]["count"] == len(can) == 2
    assert numbers["by_object"]["can"]["success_rate"] == np.mean([trial["success"] for trial in can])
    both = [numbers["by_object"][name]["success_rate"] for name in ("can", "tennis_ball")]
    assert numbers["mean_over_objects"]["success_rate"] == pytest.approx(np.mean(both))
    legacy = numbers["legacy"]
    assert legacy["success_rate"] >= rate
    per_step = numbers["sim_distance_world_mm_s"] * 0.0289
    assert legacy["sim_distance_mm_per_28.9_ms"] == pytest.approx(per_step)


def test_recorded_trials_can_be_replayed(recorded, good, things, allegro):
    result, folder = recorded
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["0000_can.npz", "0001_can.npz", "0002_tennis_ball.npz", "0003_tennis_ball.npz"]
    for row, name in enumerate(names):
        trial = replay(folder / name)
        assert trial.index == row and trial.object_name == good.object_name[row] and trial.hand == "allegro"
        assert trial.success == result.outcomes.success[row] and trial.reason == result.outcomes.reason[row]
        assert trial.times[0] == 0.0
        np.testing.assert_allclose(np.diff(trial.times), 0.02, atol=1e-6)
        assert [name for _, name in trial.phases] == ["approach", "lift", "hold"]
        hold = trial.times[trial.phase == 2]
        assert 3.0 - 0.03 <= hold[-1] - hold[0] <= 3.1 + 0.03
        assert trial.link_contacts.shape == (len(trial.times), len(allegro.links))
        assert trial.joint_positions.shape == (len(trial.times), len(allegro.joint_names))
        if trial.success:
            origin = trial.object_pose[trial.phase == 2, 2]
            assert origin.min() > trial.object_pose[0, 2] + 0.08
            assert trial.link_contacts[-1].any() and not trial.link_contacts[0].any()


def test_a_recorded_state_is_one_of_the_scene(recorded, things, allegro):
    """Its qpos, put into the scene's model, gives the recorded palm."""
    import mujoco

    from fungrasp.simulation import build_scene

    trial = replay(recorded[1] / "0000_can.npz")
    model = build_scene(allegro, {"can": things["can"]}).model
    data = mujoco.MjData(model)
    data.qpos[:] = trial.qpos[-1]
    data.mocap_pos[0], data.mocap_quat[0] = trial.wrist_reference[:3], trial.wrist_reference[3:]
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body(f"hand/{allegro.palm}").xpos, trial.palm_pose[-1, :3], atol=1e-5)
    np.testing.assert_allclose(data.body("object").xpos, trial.object_pose[-1, :3], atol=1e-5)


def test_what_is_no_recorded_trial(tmp_path):
    with pytest.raises(FungraspError, match="does not exist"):
        replay(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("text")
    with pytest.raises(FungraspError, match=r"recorded episode .* can't be read"):
        replay(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", times=np.zeros(3))
    with pytest.raises(FungraspError, match="not a recorded episode"):
        replay(tmp_path / "other.npz")


def test_unknown_policies_and_other_hands(good, things, allegro):
    with pytest.raises(UnknownNameError, match="Did you mean 'reference'"):
        evaluate(good, things, "referense")
    with pytest.raises(FungraspError, match="of the hand 'allegro', not of 'leap'"):
        evaluate(good, things, hand=load_hand("leap"))
    with pytest.raises(FungraspError, match="another version"):
        evaluate(dataclasses.replace(good, link_contacts=good.link_contacts[:, 1:]), things)


class MyPolicy:
    """What a user may write: follow the plan, ten millimeters higher."""

    def reset(self, plan: GraspPlan, observation: Observation) -> None:
        self.plan, self.object_pose = plan, observation.object_pose

    def act(self, observation: Observation) -> Action:
        step = np.rint(observation.time / self.plan.control_period).astype(int)
        goal, fingers = self.plan.at(step)
        palm = compose(self.object_pose, goal)
        palm[:, 2] += 0.01
        return Action(palm, fingers, step >= self.plan.lift_step)


def test_a_policy_of_ones_own_is_played(good, things, allegro):
    result = evaluate_in_parts(3, good, things, MyPolicy())
    assert result.policy == "MyPolicy" and result.outcomes.success.any()
    assert result_json(result)["policy"] == "MyPolicy"
    assert result.rollouts.tolist() == [0] * 4


def test_a_planner_of_ones_own_is_asked(good, things, allegro):
    asked = []

    class Planner(MotionPlanner):
        def plan(self, grasps, belief, seed=0, progress=lambda done: None):
            asked.append((len(grasps), seed))
            plans = super().plan(grasps, belief, seed)
            return dataclasses.replace(plans, rollouts=np.full(len(grasps), 5))

    result = evaluate_in_parts(
        3,
        good,
        things,
        OpenLoopPolicy(),
        spec=LiftTestSpec(seeds=(7,)),
        plans=Planner(allegro, things),
    )
    assert asked == [(3, 7), (1, 7)] and result.rollouts.tolist() == [5] * 4


def test_results_are_kept_only_of_what_has_a_name(good, things, allegro, tmp_path):
    store = PartStore(tmp_path / "x.partial")

    class Nameless:
        plan = MotionPlanner(allegro, things).plan

    for policy, planner in ((MyPolicy(), None), ("reference", Nameless())):
        with pytest.raises(FungraspError, match="given by name"):
            evaluate(good, things, policy, plans=planner, store=store)
    assert not (tmp_path / "x.partial").exists()


def test_a_protocol_is_kept_by_the_episodes(good, things, allegro, tmp_path):
    slow = LiftProtocol(wrist_speed=0.1, hold_time=0.5)
    result = evaluate(good.select([0]), things, spec=LiftTestSpec(lift=slow), record=tmp_path)
    trial = replay(tmp_path / "0000_can.npz")
    speed = np.linalg.norm(np.diff(trial.palm_pose[:, :3], axis=0), axis=1) / 0.02
    assert speed.max() < 0.12 and result.spec.lift == slow


def test_seeds_try_each_grasp_with_each(good, things, allegro, tmp_path):
    some, short = good.select([0, 2]), LiftProtocol(hold_time=0.3)
    asked = LiftTestSpec(seeds=(3, 8), randomization=Randomization(object_shift=(0.01, 0.01)), lift=short)
    result = evaluate_in_parts(1, some, things, spec=asked, record=tmp_path)
    assert result.seed.tolist() == [3, 3, 8, 8] and result.index.tolist() == [0, 1, 0, 1]
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [
        f"{row:04d}_{seed}_{name}.npz" for row, name in ((0, "can"), (1, "tennis_ball")) for seed in (3, 8)
    ]
    places = {name: replay(tmp_path / name).object_pose[0, :2] for name in names}
    assert np.abs(places["0000_3_can.npz"] - places["0000_8_can.npz"]).max() > 1e-3
    alone = evaluate(some, things, spec=dataclasses.replace(asked, seeds=(8,)), threads=1)
    for name, value in alone.outcomes.arrays().items():
        np.testing.assert_array_equal(value, result.outcomes.arrays()[name][2:], err_msg=name)
    assert [replay(tmp_path / name).index for name in names] == [0, 0, 1, 1]
