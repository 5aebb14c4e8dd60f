"""What ``torchrun`` starts twice in a test: a training of both, whose networks have to stay the same."""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from small_training import BATCH, PPO, environment

from fungrasp.training.ppo import Processes, Trainer, joined


def trained(processes: Processes, steps: int, checkpoint: Path) -> tuple[torch.Tensor, torch.Tensor]:
    """Numbers of the actor, and the last observations, of a training that goes on if it was begun."""
    trainer = Trainer(environment(processes.number), PPO, 0, processes)
    if checkpoint.exists():
        trainer.load(checkpoint)
    processes.wait()
    trainer.learn_until(steps, checkpoint=checkpoint if processes.first else None, every=1)
    assert trainer.steps == steps
    processes.wait()
    numbers = [values.double().flatten() for values in trainer.actor.state_dict().values()]
    return torch.cat(numbers), torch.as_tensor(trainer.environment.observations.robot)


def main() -> None:
    torch.set_num_threads(1)
    folder = Path(sys.argv[1])
    with joined("cpu") as processes:
        assert processes.count == 2
        whole, seen = trained(processes, 6 * BATCH, folder / "whole")
        trained(processes, 2 * BATCH, folder / "halves")
        halves, _ = trained(processes, 6 * BATCH, folder / "halves")
        for numbers in (whole, halves):
            torch.testing.assert_close(numbers, whole, rtol=0, atol=0)
        firsts = [whole.clone(), seen.clone()]
        for values in firsts:
            torch.distributed.broadcast(values, src=0)
        torch.testing.assert_close(whole, firsts[0], rtol=0, atol=0)
        assert processes.first or not torch.equal(seen, firsts[1])
        if processes.first:
            print("the same networks")


main()
