"""``python -m benchmarks.twins``."""

from __future__ import annotations

from benchmarks.command import main
from benchmarks.twins.commands import EvaluateOnTwins

if __name__ == "__main__":
    main("twins", EvaluateOnTwins)
