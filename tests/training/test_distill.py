"""Distillation goes on after an interruption."""

from __future__ import annotations

import json

import numpy as np
import pytest
from small_training import BATCH, WORLDS, distilled, trained

from fungrasp.training.distill import STUDENT, read_teacher
from fungrasp.training.settings import DistillSettings

SMALL = DistillSettings(steps=2, teacher_rounds=1, updates=1, minibatch=8)
ROUND = WORLDS * SMALL.steps
"""Control steps of a round."""


@pytest.mark.slow
def test_an_interrupted_distillation_goes_on_from_its_checkpoint(tmp_path):
    teacher, student = tmp_path / "teacher", tmp_path / "student"
    trained(teacher)
    steps = 24 * ROUND

    def interrupt(progress) -> None:
        if progress.steps >= 13 * ROUND:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        distilled(teacher, student, steps, SMALL, progress=interrupt)
    assert not (student / STUDENT).exists()
    seen: list[int] = []
    card = distilled(teacher, student, steps, SMALL, progress=lambda p: seen.append(p.steps))
    assert seen == [ROUND * i for i in range(11, 25)], "the checkpoint is of the tenth round"
    assert card.budget.steps == BATCH + steps and (student / STUDENT).is_file()
    lines = [json.loads(line)["steps"] for line in (student / "progress.jsonl").read_text().splitlines()]
    assert lines == [ROUND * i for i in range(1, 25)]


def test_random_numbers_of_an_environment_and_its_sensors_are_the_same_ones(tmp_path):
    trained(tmp_path)
    environment = read_teacher(tmp_path).environment(0, history=True, threads=1)
    state = np.random.default_rng(5).bit_generator.state
    environment.rng.bit_generator.state = state
    environment.episodes.observe()
    assert environment.rng.bit_generator.state != state, "the sensors' jitter is drawn from it"
