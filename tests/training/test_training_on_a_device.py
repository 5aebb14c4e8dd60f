"""Training whose worlds are tensors: the same as on arrays, and nothing in a control step that waits for the
device. MuJoCo's arrays as tensors stand for the GPU; Warp's own CPU device is tried where it is installed."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from small_training import BATCH, PPO, WORLDS, environment, run_spec, trained
from tensor_engine import meta, tensor, tensor_worlds
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from fungrasp.policies.residual_action import ResidualSettings
from fungrasp.sim2real import MODERATE, REALITY, WIDE, Randomization
from fungrasp.simulation import make_engine
from fungrasp.training.environment import EndedEpisodes, TrainingEnvironment
from fungrasp.training.ppo import Trainer

KINDS: dict[str, dict[str, Any]] = {
    "plan": {"randomization": MODERATE, "history": True, "early": (-9, -5)},
    "plan, wide": {"randomization": WIDE},
    "guided, reality": {"randomization": REALITY, "residual": ResidualSettings("guided"), "early": (-6, 2)},
    "filtered": {"randomization": replace(MODERATE, tracker_time_constant=0.1, tracker_dropout=0.3)},
}
KINDS["filtered"]["early"] = (-9, -5)


class SameJitter:
    """Random numbers that tensors and arrays share."""

    def __init__(self, rng: np.random.Generator):
        self._rng = rng

    def normal(self, *, size: tuple[int, int]) -> Any:
        return torch.from_numpy(self._rng.normal(size=size))

    def random(self, count: int, /) -> Any:
        return torch.from_numpy(self._rng.random(count))


def on_tensors(monkeypatch: pytest.MonkeyPatch, convert: Any, **settings: Any) -> TrainingEnvironment:
    with monkeypatch.context() as patch:
        patch.setattr("fungrasp.training.environment.make_engine", tensor_worlds(convert))
        return environment(**settings)


@pytest.mark.parametrize("kind", KINDS)
def test_worlds_of_tensors_do_what_worlds_of_arrays_do(kind, monkeypatch):
    """Actions, sensors, contacts, rewards, ends and new episodes, with the same random numbers."""
    arrays = environment(**KINDS[kind])
    tensors = on_tensors(monkeypatch, tensor, **KINDS[kind])
    tensors.episodes.sensors.rng = SameJitter(tensors.rng)
    for worlds in (arrays, tensors):
        worlds.reseed(5)
        worlds.restart()
    rng, ended = np.random.default_rng(0), 0
    for _ in range(24):
        action = rng.normal(size=(WORLDS, arrays.actions))
        a, b = arrays.step(action), tensors.step(torch.from_numpy(action))
        ended += len(arrays.ended.worlds)
        np.testing.assert_array_equal(tensors.ended.worlds, arrays.ended.worlds)
        np.testing.assert_array_equal(tensors.ended.success, arrays.ended.success)
        np.testing.assert_allclose(b.reward.numpy(), a.reward, atol=1e-3)
        for name in a.terms:
            assert float(b.terms[name]) == pytest.approx(float(a.terms[name]), abs=1e-3), name
        for name in ("robot", "privileged", "value", "history"):
            expected = getattr(arrays.observations, name)
            if expected is None:
                continue
            found = getattr(tensors.observations, name)
            assert found.dtype == torch.float32
            # Contacts make more of the last digit in each step; a normal of the surface turns at an edge.
            apart = np.abs(found.numpy() - expected)
            assert np.mean(apart > 5e-3) < 0.002 and apart.max() < 0.1, name
    assert ended or kind == "plan, wide", kind
    np.testing.assert_array_equal(tensors.success_of_group, arrays.success_of_group)


class NothingFromTheProcessor(TorchDispatchMode):
    """Complains where numbers go from the processor to the device: it would be waited for."""

    def __torch_dispatch__(self, function, types, given=(), named=None):  # type: ignore[override]
        found = function(*given, **(named or {}))
        leaves = [leaf for leaf in tree_leaves(given) if isinstance(leaf, torch.Tensor) and leaf.ndim]
        from_here = [leaf for leaf in leaves if leaf.device.type == "cpu"]
        there = isinstance(found, torch.Tensor) and found.device.type == "meta"
        assert not (there and from_here), f"{function} takes {[tuple(t.shape) for t in from_here]} along"
        return found


@pytest.mark.parametrize("kind", ["plan", "guided, reality", "filtered"])
def test_a_control_step_neither_asks_the_device_nor_sends_it_anything(kind, monkeypatch):
    """Where episodes end, new ones are sent; nothing is asked then, either."""
    worlds = on_tensors(monkeypatch, meta, **KINDS[kind])
    some = EndedEpisodes(np.array([1, 4]), np.array([True, False]))
    monkeypatch.setattr(worlds, "end", lambda step: some)
    action = torch.zeros(WORLDS, worlds.actions, device="meta")
    worlds.step(action)
    worlds.step(action)
    with NothingFromTheProcessor():
        step = worlds.advance(action)
        seen = worlds.named_observations(True)
    for made in (step.reward, step.done, step.success, *step.terms.values(), *seen.values()):
        assert made.device.type == "meta"
    for name in ("robot", "privileged", "value"):
        assert getattr(worlds.observations, name).device.type == "meta"


def test_ppo_learns_on_tensors_and_goes_on_from_a_checkpoint(monkeypatch, tmp_path):
    """As if it had never been interrupted; a training on arrays reads the checkpoint, too."""

    def learned(steps: int, *after: Any) -> Trainer:
        trainer = Trainer(on_tensors(monkeypatch, tensor, history=True), PPO, seed=1)
        for path in after:
            trainer.load(path)
        trainer.learn_until(steps, checkpoint=tmp_path / "kept", every=1)
        return trainer

    whole = learned(3 * BATCH)
    # The worlds hold no tensors of the runner's inference mode, which could not be changed in place.
    whole.environment.restart()
    (tmp_path / "kept").unlink()
    learned(BATCH)
    halves = learned(3 * BATCH, tmp_path / "kept")
    for a, b in zip(whole.actor.parameters(), halves.actor.parameters(), strict=True):
        np.testing.assert_array_equal(a.detach().numpy(), b.detach().numpy())
    assert halves.steps == 3 * BATCH
    arrays = Trainer(environment(), PPO)
    arrays.load(tmp_path / "kept")
    assert arrays.steps == 3 * BATCH


@pytest.mark.slow
class TestOnWarp:
    """Warp's own CPU device. Kernels are compiled once, for two minutes."""

    @pytest.fixture(autouse=True)
    def _installed(self):
        pytest.importorskip("mujoco_warp", reason='the extra "gpu" is not installed')

    def test_a_few_steps_are_those_on_arrays(self, monkeypatch):
        """The same seed, worlds and actions: on copies of the same physics while hands close, and before that
        in MuJoCo on the processor, where objects rest micrometers away. Random numbers of a step are a
        device's own, and left out."""
        still = Randomization(
            **{name: getattr(WIDE, name) for name in ("mass", "friction", "joint_damping", "action_delay")}
        )
        for early, steps, copies, apart in (((6, 8), 3, False, 2e-2), ((-1, 2), 5, True, 5e-4)):
            settings = {"randomization": still, "early": early, "whole": 0.0}
            tensors = environment(device="cpu-warp", **settings)
            with monkeypatch.context() as patch:
                patch.setattr(
                    "fungrasp.training.environment.make_engine",
                    lambda scene, count, threads, tensors: make_engine(scene, count, 1),
                )
                arrays = environment(device="cpu-warp" if copies else "cpu", **settings)
            assert isinstance(arrays.on, np.ndarray) and isinstance(tensors.on, torch.Tensor)
            for worlds in (arrays, tensors):
                worlds.reseed(3)
                worlds.restart()
            rng = np.random.default_rng(0)
            for _ in range(steps):
                action = 0.3 * rng.normal(size=(WORLDS, arrays.actions))
                a, b = arrays.step(action), tensors.step(torch.from_numpy(action).float())
                np.testing.assert_allclose(b.reward.numpy(), a.reward, atol=apart)
                for name in ("robot", "privileged", "value"):
                    expected, found = (getattr(one.observations, name) for one in (arrays, tensors))
                    off = np.abs(found.numpy() - expected)
                    assert np.median(off) < 1e-4 and (off < 20 * apart).mean() > 0.99, name

    def test_train_goes_on_from_where_it_was(self, tmp_path):
        folder = tmp_path / "teacher"
        for updates in (1, 2):
            card = trained(folder, run_spec(updates * BATCH), device="cpu-warp")
            assert card.budget.steps == updates * BATCH
        assert (folder / "policy.onnx").is_file()


@pytest.mark.slow
def test_processes_of_torchrun_learn_together_and_go_on_from_a_checkpoint(tmp_path):
    """As on several GPUs: the same networks in both, other worlds, and the same end after an interruption."""
    script = Path(__file__).parent.parent / "helpers" / "two_processes.py"
    words = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    given = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [*words, str(script), str(tmp_path)], env=given, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0 and "the same networks" in done.stdout, done.stderr[-3000:]
