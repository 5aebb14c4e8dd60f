"""Load hands by name: built-in, from other packages (entry point ``fungrasp.hands``), or from a TOML file."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.hands.hand import Hand, read_hand_toml

MODEL_SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro")
"""Suffixes of model files, of which ``fungrasp hands add`` makes hands."""


@cache
def hand_files() -> dict[str, Path]:
    """Return the TOML files of all known hands by name. Entry points are functions that return the path of a
    folder or TOML file."""
    files = {path.parent.name: path for path in sorted(Path(__file__).parent.glob("*/hand.toml"))}
    for entry in entry_points(group="fungrasp.hands"):
        files.setdefault(entry.name, _toml_in(Path(entry.load()())))
    return files


def load_hand(name: str | Path) -> Hand:
    """Load a hand by name ("allegro"), or by the path of its TOML file or folder.

    Raises:
        FungraspError: the hand is unknown, or its files are invalid.
    """
    text = str(name)
    if text in hand_files():
        return read_hand_toml(hand_files()[text])
    if text.endswith(".toml") or Path(text).is_dir():
        path = _toml_in(Path(text))
        if not path.is_file():
            raise FungraspError(f"the hand file {path} does not exist")
        return read_hand_toml(path)
    if Path(text).suffix.lower() in MODEL_SUFFIXES:
        raise FungraspError(
            f"{text} is a model, which does not name palm and fingers: 'fungrasp hands add {text}' makes a "
            "hand of it"
        )
    raise UnknownNameError("hand", text, hand_files())


def check_no_hand(objects: object) -> None:
    """Check the argument for objects, which precedes ``hand``, for hands.

    Raises:
        FungraspError: the argument is a hand or its name.
    """
    name = objects.name if isinstance(objects, Hand) else objects
    if isinstance(name, str) and name in hand_files() and not Path(name).is_dir():
        raise FungraspError(f"the second argument is the objects, and '{name}' is a hand: give hand='{name}'")


def as_hand(hand: Hand | str | Path) -> Hand:
    """Return the given hand, or load it by name or path.

    Raises:
        FungraspError: the hand is unknown, or the argument has another type.
    """
    if isinstance(hand, Hand):
        return hand
    if isinstance(hand, str | Path):
        return load_hand(hand)
    raise FungraspError(f"expected a hand, or the name or path of one, not {type(hand).__name__}")


def hand_origin(hand: Hand) -> str:
    """Return the path of the TOML file if ``load_hand`` does not find this hand by its name, else ""."""
    known = hand_files().get(hand.name)
    return "" if known is not None and known.resolve() == hand.path.resolve() else str(hand.path.absolute())


def _toml_in(path: Path) -> Path:
    return path / "hand.toml" if path.is_dir() else path
