"""Distillation draws from the environment's generator."""

from __future__ import annotations

import numpy as np
from small_training import trained

from fungrasp.training.distill import read_teacher


def test_random_numbers_of_an_environment_and_its_sensors_are_the_same_ones(tmp_path):
    trained(tmp_path)
    environment = read_teacher(tmp_path).environment(0, history=True, threads=1)
    state = np.random.default_rng(5).bit_generator.state
    environment.rng.bit_generator.state = state
    environment.episodes.observe()
    assert environment.rng.bit_generator.state != state, "the sensors' jitter is drawn from it"
