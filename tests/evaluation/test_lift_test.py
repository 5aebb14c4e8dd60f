"""The dynamic test through its public door: results, records, resuming, disturbances."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from fungrasp.errors import FungraspError, UnknownNameError
from fungrasp.evaluation import DynamicResult, evaluate, replay, result_json
from fungrasp.evaluation.lift_test import Refinement
from fungrasp.evaluation.partial_results import PartialResults
from fungrasp.files import digest
from fungrasp.hands import load_hand


@pytest.fixture(scope="module")
def recorded(good, things, allegro, tmp_path_factory):
    """A result and the folder its trials were recorded to."""
    folder = tmp_path_factory.mktemp("trials")
    return evaluate(good, things, allegro, record=folder), folder


def same(a: DynamicResult, b: DynamicResult) -> bool:
    names = [field.name for field in dataclasses.fields(a.trials)]
    return all(np.array_equal(getattr(a.trials, name), getattr(b.trials, name)) for name in names)


def test_good_grasps_succeed_and_nothing_depends_on_threads_or_chunks(recorded, good, things, allegro):
    result, _ = recorded
    assert result.trials.success.sum() >= 3
    done = []
    other = evaluate(good, things, allegro, threads=1, chunk=3, progress=done.append)
    assert same(result, other)
    assert done == sorted(done) and done[-1] == 4 and 0 < done[0] < 3


def test_the_json_has_every_number_and_they_agree(recorded):
    result, _ = recorded
    numbers = json.loads(json.dumps(result_json(result), allow_nan=False))
    assert numbers["hand"] == "allegro" and numbers["policy"] == "reference" and numbers["seed"] == 0
    assert numbers["protocol"]["hold_time"] == 3.0 and numbers["disturbance"]["mass_scale"] == 1.0
    trials = numbers["trials"]
    assert [trial["index"] for trial in trials] == [0, 1, 2, 3]
    assert {"object", "task", "success", "lifted_height_m", "reason", "contact_f1", "refined_tries"} <= set(
        trials[0]
    )
    rate = np.mean([trial["success"] for trial in trials])
    assert numbers["success_rate"] == rate
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
        assert trial.success == result.trials.success[row] and trial.reason == result.trials.reason[row]
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
    with pytest.raises(FungraspError, match="no recorded trial"):
        replay(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", times=np.zeros(3))
    with pytest.raises(FungraspError, match="no recorded trial"):
        replay(tmp_path / "other.npz")


class Interrupted(Exception):
    pass


def test_an_interrupted_test_goes_on_where_it_was(recorded, good, things, allegro, tmp_path):
    store = tmp_path / "E.json.partial"

    def interrupt(done: float) -> None:
        if done > 2.2:
            raise Interrupted

    with pytest.raises(Interrupted):
        evaluate(good, things, allegro, store=PartialResults(store), chunk=2, progress=interrupt)
    assert store.is_file()
    seen: list[float] = []
    result = evaluate(good, things, allegro, store=PartialResults(store), chunk=2, progress=seen.append)
    assert seen[0] == 2, "the first chunk was not simulated again"
    assert same(result, recorded[0])
    seen.clear()
    changed = dataclasses.replace(good, object_mass=1.5 * good.object_mass)
    other = evaluate(changed, things, allegro, store=PartialResults(store), chunk=2, progress=seen.append)
    assert 0 < seen[0] < 2 and not same(other, result), "what was kept is of other grasps"


def test_partial_results_survive_a_file_that_cannot_be_read(tmp_path):
    path = tmp_path / "x.partial"
    path.write_bytes(b"PK\x03\x04 cut short")
    store = PartialResults(path)
    assert store.load("a") is None
    store.save("a", {"x": np.arange(3), "reason": np.array(["", "lost"])})
    again = PartialResults(path)
    kept = again.load("a")
    assert kept is not None and kept["x"].tolist() == [0, 1, 2] and kept["reason"].tolist() == ["", "lost"]
    assert again.load("b") is None
    again.remove()
    assert not path.exists()
    again.remove()


def test_digests_tell_inputs_apart():
    base = digest(np.arange(3), {"a": np.zeros(2), "b": 1}, "text")
    assert base == digest(np.arange(3), {"b": 1, "a": np.zeros(2)}, "text")
    others = [
        digest(np.arange(3.0), {"a": np.zeros(2), "b": 1}, "text"),
        digest(np.arange(3), {"a": np.zeros(2), "b": 2}, "text"),
        digest(np.arange(3), {"a": np.zeros((2, 1)), "b": 1}, "text"),
        digest(np.arange(3), {"a": np.zeros(2), "b": 1}, "texts"),
    ]
    assert len({base, *others}) == 5


def test_a_refinement_is_applied_before_the_trials(good, things, allegro):
    """One that takes the hand away."""
    seeds = []

    def away(grasps, seed):
        seeds.append(seed)
        extra = {"refined_tries": np.full(len(grasps), -3)}
        wrist = grasps.wrist_pose + np.array([0, 0, 0.3, 0, 0, 0, 0])
        return dataclasses.replace(grasps, wrist_pose=wrist, extra=extra)

    result = evaluate(good.select([2]), things, allegro, seeds=(4, 5), refine=Refinement(away, "away"))
    assert seeds == [4, 5] and result.seed.tolist() == [4, 5]
    assert not result.trials.success.any() and (result.refined_tries == -3).all()
    assert result_json(result)["seed"] == [4, 5]


def test_unknown_policies_and_other_hands(good, things, allegro):
    with pytest.raises(UnknownNameError, match="Did you mean 'reference'"):
        evaluate(good, things, allegro, "referense")
    with pytest.raises(FungraspError, match="of the hand 'allegro', not of 'leap'"):
        evaluate(good, things, load_hand("leap"))
    with pytest.raises(FungraspError, match="another version"):
        evaluate(dataclasses.replace(good, link_contacts=good.link_contacts[:, 1:]), things, allegro)
