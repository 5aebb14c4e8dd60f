"""Robot hands. A hand is a folder with a model and a TOML file that names the bodies of palm and fingers."""

from fungrasp.hands.hand import FINGERS, Actuator, Finger, Hand, read_hand_toml
from fungrasp.hands.hand_registry import as_hand, hand_files, hand_origin, load_hand

__all__ = [
    "FINGERS",
    "Actuator",
    "Finger",
    "Hand",
    "as_hand",
    "hand_files",
    "hand_origin",
    "load_hand",
    "read_hand_toml",
]
