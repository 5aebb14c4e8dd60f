"""Types of the values in a hand's TOML."""

from __future__ import annotations

from fungrasp.core.formats.text_files import Schema

_SERVO = {"kp": float, "kd": float, "force_limit": float}

HAND_TOML: Schema = {
    "name": str,
    "title": str,
    "model": str,
    "palm": str,
    "source": str,
    "palm_frame": {"fingers": [float], "normal": [float]},
    "fingers": {"*": {"links": [str], "joints": [str], "tip": str}},
    "actuators": {**_SERVO, "source": str, "joints": {"*": _SERVO}},
}
