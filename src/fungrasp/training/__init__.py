"""Training: PPO for teachers, distillation for students."""

import importlib
import os

from fungrasp.core.errors import FungraspError

# rsl-rl's runner imports GitPython, which raises an error if git is not installed.
os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")


def check_packages() -> None:
    """Check that the packages for training are installed.

    Raises:
        FungraspError: a package is missing.
    """
    try:
        for name in ("torch", "rsl_rl", "tensorboard"):
            importlib.import_module(name)
    except ImportError as error:
        raise FungraspError(
            f'training needs more packages ({error}): pip install ".[learning]" in the clone'
        ) from error
