"""Plans that are kept, looked at and carried out: what moves is what was planned, where it was planned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_cells import cell_and_hand, grasp_and_object, near_cell, placed

from fungrasp.cli.main import main
from fungrasp.core.errors import FungraspError
from fungrasp.deployment.deployment_result import DeploymentSpec
from fungrasp.deployment.log import read_log
from fungrasp.deployment.phases import Phase
from fungrasp.deployment.plan_ahead import execute_plan, plan_ahead
from fungrasp.deployment.preparation import GraspPreparer
from fungrasp.deployment.rehearsal import rehearse
from fungrasp.deployment.saved_plan import (
    ObjectSource,
    SavedPlan,
    SavedPlanPreparer,
    check_unchanged,
    digests,
    load_plan,
)
from fungrasp.geometry.poses import quaternion_from_rotation_vector, quaternion_multiply
from fungrasp.objects import load_object
from fungrasp.planning import MotionPlanner
from fungrasp.robots.cell import Obstacle
from fungrasp.robots.kinematics.arm_model import ClearanceModel
from fungrasp.robots.twin.devices import TwinArm, TwinHand

pytest.importorskip("mink")

SPEC = DeploymentSpec(policy="reference", real_time=False)

MUG = 5
"""A built-in grasp that the reference policy lifts with several seeds."""


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> tuple[SavedPlan, Path, list[str]]:
    """A plan, its file, and what was told to devices while it was made."""
    grasp, thing = grasp_and_object()
    sent: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        for device in (TwinArm, TwinHand):
            patch.setattr(device, "command", lambda self, *given: sent.append(self.name))
        plan = plan_ahead(grasp, {thing.name: thing}, ObjectSource(thing.name, thing.mass), SPEC)
    path = tmp_path_factory.mktemp("plan") / "lift.npz"
    plan.save(path)
    return plan, path, sent


def test_planning_sends_nothing_and_holds_the_whole_way(saved: Any) -> None:
    plan, path, sent = saved
    assert not sent
    motion = plan.motion
    phases = list(dict.fromkeys(motion.phases.tolist()))
    assert phases == ["move to start", "grasp", "lift", "hold", "put down", "home"]
    np.testing.assert_allclose(motion.arm[[0, -1]], [plan.arm, plan.arm], atol=1e-3)
    height = motion.object_pose[:, 2] - motion.object_pose[0, 2]
    assert height.max() == pytest.approx(0.15, abs=0.01) and abs(height[-1]) < 1e-9
    assert (np.diff(motion.times) > 0).all()
    again = load_plan(path)
    assert again.digest == plan.digest and again.origin == plan.origin
    np.testing.assert_array_equal(again.prepared.plan.palm_goal, plan.prepared.plan.palm_goal)


def test_what_is_executed_is_what_was_planned(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    # The reference policy lifts the glass of the other tests on some processors and drops it on others.
    grasp, thing = grasp_and_object(MUG)
    plan = plan_ahead(grasp, {thing.name: thing}, ObjectSource(thing.name, thing.mass), SPEC)
    plan.save(tmp_path / "lift.npz")
    result = execute_plan(load_plan(tmp_path / "lift.npz"), real_time=False, log=tmp_path / "log.mcap")
    assert result.phase is Phase.DONE and result.success
    log = read_log(tmp_path / "log.mcap")
    assert log.about["saved plan"] == plan.digest
    sent = np.array([message["sent"]["arm"] for message in log.messages["/setpoint"]])
    away = np.array([np.abs(plan.motion.arm - posture).max(axis=1).min() for posture in sent[::5]])
    # The arm begins within the twin's noise of where it was.
    assert away.max() < 0.01


@pytest.mark.parametrize("name", ["robot cell", "hand", "object", "policy", "identified dynamics"])
def test_another_one_of_what_it_was_made_of_is_refused(name: str, saved: Any) -> None:
    plan = saved[0]
    other = {**plan.origin.digests, name: "another one"}
    spoiled = replace(plan, origin=replace(plan.origin, digests=other))
    with pytest.raises(FungraspError, match=f"the {name} is not the one"):
        execute_plan(spoiled, real_time=False)


def test_digests_tell_cells_and_meshes_apart(tmp_path: Path, saved: Any) -> None:
    (cell, hand), (_, thing) = cell_and_hand(), grasp_and_object()
    known = saved[0].origin.digests
    assert digests(cell, hand, thing, "reference", "") == known
    slower = replace(cell, limits=replace(cell.limits, palm_speed=0.1))
    with pytest.raises(FungraspError, match="robot cell"):
        check_unchanged(saved[0], digests(slower, hand, thing, "reference", ""))
    thing.mesh.copy().apply_scale(1.01).export(tmp_path / f"{thing.name}.obj")
    larger = load_object(thing.name, thing.mass, tmp_path)
    with pytest.raises(FungraspError, match="object"):
        check_unchanged(saved[0], digests(cell, hand, larger, "reference", ""))


def test_a_file_that_was_changed_is_refused(saved: Any, tmp_path: Path) -> None:
    with np.load(saved[1]) as data:
        arrays = dict(data)
    arrays["corners"] = arrays["corners"] + 0.01
    np.savez(tmp_path / "changed.npz", **arrays)
    with pytest.raises(FungraspError, match="is not as it was written"):
        load_plan(tmp_path / "changed.npz")
    (tmp_path / "cut.npz").write_bytes(saved[1].read_bytes()[:5000])
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for name, said in (("cut", "can't be read"), ("other", "is no saved plan"), ("none", "does not exist")):
        with pytest.raises(FungraspError, match=said):
            load_plan(tmp_path / f"{name}.npz")


def test_an_object_elsewhere_is_refused_and_said_how_far(saved: Any) -> None:
    plan = saved[0]
    preparer, pose = SavedPlanPreparer(plan, {}), plan.prepared.plan.object_pose[0]
    near = pose + np.array([0.005, 0.005, 0, 0, 0, 0, 0])
    assert preparer.prepare(plan.grasp, near, plan.arm) is plan.prepared
    with pytest.raises(FungraspError, match="'wine_glass' is 12 mm and 0 degrees from where the plan has it"):
        preparer.prepare(plan.grasp, pose + np.array([0.012, 0, 0, 0, 0, 0, 0]), plan.arm)
    turned = pose.copy()
    turned[3:] = quaternion_multiply(quaternion_from_rotation_vector(np.array([0.0, 0.0, 0.2])), pose[3:])
    with pytest.raises(FungraspError, match="0 mm and 11 degrees"):
        preparer.prepare(plan.grasp, turned, plan.arm)


def test_an_arm_elsewhere_is_refused_and_one_at_the_start_goes_on_from_there(saved: Any) -> None:
    plan = saved[0]
    preparer, pose = SavedPlanPreparer(plan, {}), plan.prepared.plan.object_pose[0]
    with pytest.raises(FungraspError, match=r"the arm is 0\.10 rad from"):
        preparer.prepare(plan.grasp, pose, plan.arm + 0.1)
    start = plan.prepared.corners[-1]
    there = preparer.prepare(plan.grasp, pose, start + 0.01)
    np.testing.assert_array_equal(there.corners, [start])
    np.testing.assert_array_equal(there.behind[-1], plan.arm)


def test_a_plan_that_the_safety_filter_would_stop_is_refused() -> None:
    (cell, hand), (grasp, thing) = cell_and_hand(), grasp_and_object()
    preparer = GraspPreparer(cell, hand, thing, MotionPlanner(hand, {thing.name: thing}))
    arm = np.array(near_cell().arm.home)
    prepared = preparer.prepare(grasp, placed(), arm)
    motion = rehearse(cell, hand, grasp, prepared, arm, hand.open_joints)
    gaps = ClearanceModel(cell, hand)
    # Hands that opened at once over an object that was put down reached 27 mm into the table.
    down = motion.phases == Phase.PUT_DOWN
    reached = [gaps.measure(a, f).hand for a, f in zip(motion.arm[down], motion.fingers[down], strict=True)]
    assert min(reached) > -cell.workspace.hand_depth
    above = replace(cell, workspace=replace(cell.workspace, hand_depth=-0.005))
    with pytest.raises(FungraspError, match=r"the safety filter would stop this plan while 'grasp'.*table"):
        rehearse(above, hand, grasp, prepared, arm, hand.open_joints)


def test_slow_motion_is_not_for_policies_that_watch(saved: Any) -> None:
    plan = saved[0]
    watching = replace(plan.origin.spec, policy="student")
    spoiled = replace(plan, origin=replace(plan.origin, spec=watching, digests={}))
    with pytest.raises(FungraspError, match=r"acts at 10 Hz: it can't be slowed down to 0\.1"):
        execute_plan(spoiled, speed=0.1, real_time=False)


def test_the_command_refuses_without_a_terminal_and_options_of_the_plan(
    saved: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = str(saved[1])
    for given, said in (
        (["--execute", path], "it needs a terminal, or --yes"),
        (["--execute", path, "--yes", "--policy", "student"], "leave out --policy"),
        (["--execute", path, "--yes", "--grasp", "mug"], "leave out the grasp"),
        (["--execute", path, "--yes", "--save-plan", "b.npz"], "leave out --save-plan"),
        (["--save-plan", str(tmp_path / "plan.json")], "ends in .npz"),
    ):
        assert main(["deploy", *given]) == 2
        assert said in capsys.readouterr().err


def test_a_real_robot_moves_for_nobody_who_is_not_asked(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_text(
        'hand = "allegro"\n[arm]\ndriver = "ur-rtde"\naddress = "192.0.2.1"\n'
        "[mount]\npose_flange_hand = [0.0, 0.0, 0.04, 1.0, 0.0, 0.0, 0.0]\n"
        '[hand_device]\ndriver = "allegro-can"\naddress = "can0"\n'
        '[tracker]\ndriver = "pose-stream"\naddress = "tcp://192.0.2.2:5556"\ncalibration_residual = 0.002\n'
    )
    assert main(["deploy", "--robot", str(cell), "--log", str(tmp_path / "log.mcap")]) == 2
    assert "it needs a terminal, or --yes" in capsys.readouterr().err


def test_a_picture_and_a_film_are_drawn(saved: Any, tmp_path: Path) -> None:
    from PIL import Image

    from fungrasp.media.plan_pictures import write_plan_pictures

    plan, (cell, hand), thing = saved[0], cell_and_hand(), grasp_and_object()[1]
    pedestal = Obstacle((-0.5, 0.0, 0.14), (0.25, 0.25, 0.28))
    cell = replace(cell, obstacles=(pedestal,))
    rows = [int(np.argmax(plan.motion.phases == phase)) for phase in dict.fromkeys(plan.motion.phases)]
    few = replace(plan.motion, **{name: value[rows] for name, value in vars(plan.motion).items()})
    few = replace(few, times=0.2 * np.arange(len(rows)))
    picture, film = write_plan_pictures(tmp_path / "lift.npz", replace(plan, motion=few), cell, hand, thing)
    seen = np.asarray(Image.open(picture)).astype(int)
    assert seen.std() > 10 and film.stat().st_size > 1000
    # The pedestal is drawn: nothing else is as red.
    red, green, blue = np.moveaxis(seen, -1, 0)
    assert ((red > green + 25) & (red > blue + 25)).sum() > 2000
