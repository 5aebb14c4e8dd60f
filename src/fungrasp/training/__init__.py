"""Training: PPO for teachers, distillation for students."""

import os

# rsl-rl's runner imports a package that looks for the program git, and fails where there is none.
os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
