"""Training: PPO for teachers, distillation for students."""

import os

# rsl-rl's runner imports GitPython, which raises an error if git is not installed.
os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
