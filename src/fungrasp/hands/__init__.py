"""One folder per hand: a model and a TOML that says which body is which finger link."""

from fungrasp.hands.hand import FINGERS, Actuator, Finger, Hand, read_hand_toml
from fungrasp.hands.hand_registry import hand_files, load_hand

__all__ = ["FINGERS", "Actuator", "Finger", "Hand", "hand_files", "load_hand", "read_hand_toml"]
