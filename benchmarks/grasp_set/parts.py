"""The folder of a set: grasps of three parts that share no object, the meshes, and what each object is."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError, UnknownNameError
from fungrasp.core.files import atomic_path
from fungrasp.core.formats.text_files import read_json
from fungrasp.grasps import HumanGraspSet, load_human_grasps, load_objects, save_human_grasps
from fungrasp.objects import ObjectModel

PARTS = ("train", "validation", "test")
"""To train on; to compare variants on; to look at once for each decision."""

EARLIER = {"train": "train", "validation": "choose", "test": "confirm"}
"""Names of the parts in sets that were made before."""

OBJECTS, INDEX = "objects", "set.json"
"""Folder of the meshes, and file that says what each object is."""


@dataclass(frozen=True, eq=False)
class SetPart:
    """One part of a set."""

    name: str
    """One of ``PARTS``."""
    grasps: HumanGraspSet
    """N grasps."""
    stratum: np.ndarray
    """Kind of each grasp's object, shape [N] str; "dexycb" for grasps of DexYCB."""
    objects: Mapping[str, ObjectModel]
    """By name."""


def split_objects(families: Sequence[tuple[str, str]], names: Sequence[str], seed: int) -> dict[str, str]:
    """The part of each object: the objects of each family, in random order, are dealt to the parts in turn.

    Args:
        families: stratum and family of each object; those of "ycb" are dealt together, as each is a family of
            its own.
        names: of the objects.
        seed: of the order.
    """
    rng = np.random.default_rng([seed, 3])
    groups: dict[tuple[str, str], list[str]] = {}
    for (stratum, family), name in zip(families, names, strict=True):
        groups.setdefault((stratum, "" if stratum == "ycb" else family), []).append(name)
    dealt, turn = {}, 0
    for group in groups.values():
        for number in rng.permutation(len(group)):
            dealt[group[number]] = PARTS[turn % len(PARTS)]
            turn += 1
    return dealt


def save_set(
    folder: Path,
    grasps: HumanGraspSet,
    stratum: np.ndarray,
    parts: Mapping[str, str],
    about: Mapping[str, Any],
) -> None:
    """Write the parts' grasps, ``<part>.npz``, and the index.

    Args:
        folder: of the set; its meshes are there already.
        grasps: N grasps, of all parts.
        stratum: of each, shape [N] str.
        parts: of each object, by its name.
        about: how the set was made.

    Raises:
        FungraspError: a file can't be written, or a part has no grasps.
    """
    part = np.array([parts[name] for name in grasps.object_name.tolist()])
    index = {}
    for name in PARTS:
        rows = np.flatnonzero(part == name)
        rows = rows[np.argsort(stratum[rows], kind="stable")]
        if not len(rows):
            raise FungraspError(f"the part '{name}' would have no grasps: make more objects")
        some = grasps.select(rows)
        file = folder / f"{name}.npz"
        save_human_grasps(file, some)
        names, counts = np.unique(stratum[rows], return_counts=True)
        strata = dict(zip(names.tolist(), counts.tolist(), strict=True))
        index[name] = {
            "grasps": len(some),
            "objects": len(set(some.object_name.tolist())),
            "strata": strata,
            "sha256": sha256(file.read_bytes()).hexdigest(),
        }
    with atomic_path(folder / INDEX) as temporary:
        temporary.write_text(json.dumps({**about, "parts": index}, indent=1) + "\n")


def load_part(folder: Path, name: str) -> SetPart:
    """A part of a set.

    Raises:
        FungraspError: there is no such part, a file can't be read, or the index is not that of the grasps.
    """
    if name not in PARTS:
        raise UnknownNameError("part", name, PARTS)
    index = read_json(folder / INDEX, "index of a grasp set")
    stored = name if (folder / f"{name}.npz").exists() else EARLIER[name]
    file = folder / f"{stored}.npz"
    grasps = load_human_grasps(file)
    try:
        strata, digest = index["parts"][stored]["strata"], index["parts"][stored]["sha256"]
        stratum = np.repeat(list(strata), list(strata.values()))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise FungraspError(f"{folder / INDEX} is no index of a grasp set") from error
    if digest != sha256(file.read_bytes()).hexdigest() or len(stratum) != len(grasps):
        raise FungraspError(f"{folder / INDEX} is not the index of {file.name}: make the set again")
    return SetPart(name, grasps, stratum, load_objects(grasps, folder / OBJECTS))
