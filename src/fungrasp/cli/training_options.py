"""What the commands that train have in common."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fungrasp.core.errors import FungraspError

if TYPE_CHECKING:
    from fungrasp.hands import Hand

LINE_PERIOD = 10.0
"""Time between two lines of progress [s]."""


def predictor_file(name: str, hand: Hand) -> Path:
    """The file of a success predictor.

    Raises:
        FungraspError: there is none of this name, or it is another kind of policy.
    """
    from fungrasp.policies import policy_files

    files = policy_files(name, hand.name)
    if files.network is not None or files.predictor is None:
        raise FungraspError(f"--plans takes a success predictor, which '{name}' is not")
    return files.predictor


def check_packages() -> None:
    """Complain about missing ones.

    Raises:
        FungraspError: one that training needs is not installed.
    """
    try:
        for name in ("torch", "rsl_rl", "tensorboard"):
            importlib.import_module(name)
    except ImportError as error:
        raise FungraspError(
            f'training needs packages that are not installed ({error}): pip install "fungrasp[learning]"'
        ) from error


def check_numbers(steps: float, seed: int, threads: int) -> None:
    """Complain about impossible ones.

    Raises:
        FungraspError: one is.
    """
    if not 1 <= steps < 1e15:
        raise FungraspError(f"--steps must be at least 1, not {steps:g}")
    if seed < 0 or threads < 0:
        raise FungraspError("--seed and --threads must not be negative")


def progress_lines(steps: int) -> Callable[[Any], None]:
    """Prints steps, success and time left every now and then.

    Args:
        steps: at which training ends.

    Returns:
        To be called with what has ``steps``, ``seconds`` and ``success``.
    """
    last: tuple[float, Any] | None = None
    first: Any = None

    def show(p: Any) -> None:
        nonlocal last, first
        now = time.perf_counter()
        if first is None:
            first = p
        if p.steps < steps and last is not None and now - last[0] < LINE_PERIOD:
            return
        last = (now, p)
        done, seconds = p.steps - first.steps, p.seconds - first.seconds
        left = ""
        if done > 0 and seconds > 0 and p.steps < steps:
            rate = done / seconds
            left = f", {rate:,.0f} steps/s, {_duration((steps - p.steps) / rate)} left"
        print(f"{p.steps:,} of {steps:,} steps, success {p.success:.1%}{left}", flush=True)

    return show


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
