"""MuJoCo's bindings are compiled and come without types: every name is accepted, as ``Any``."""

from typing import Any

def __getattr__(name: str) -> Any: ...
