"""``python -m benchmarks.perception captures --track``: how well and how fast known objects are followed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fungrasp.cli.console import table, write_json

if TYPE_CHECKING:
    from fungrasp.grasps import HumanGraspSet
    from fungrasp.objects import ObjectModel

SMOOTHED = 11
"""Pixels over which the smoothed depth is averaged: as wide as measured outlines of a stereo camera."""


def bench_tracking(
    grasps: HumanGraspSet, objects: Mapping[str, ObjectModel], images: int, json: Path | None
) -> None:
    """Follow every object through images of its first grasp, print the figures and write them."""
    import numpy as np

    from benchmarks.perception.object_tracking import measure_tracking
    from fungrasp.provenance import machine

    rows = [("object", "depth", "ADD-S < 10 mm", "median [mm]", "followed", "median [s]", "CPU [s]")]
    results: list[dict[str, Any]] = []
    for name in sorted(objects):
        first = int(np.flatnonzero(grasps.object_name == name)[0])
        for smoothed in (1, SMOOTHED):
            found = measure_tracking(grasps[first], objects[name], images, smoothed=smoothed)
            results.append({"object": name, "smoothed": smoothed, **asdict(found)})
            rows.append(
                (
                    name,
                    "sharp" if smoothed == 1 else f"{smoothed} px",
                    f"{found.right:.0%}",
                    f"{found.add_s_mm:.1f}",
                    f"{found.followed:.0%}",
                    f"{found.seconds:.3f}",
                    f"{found.cpu_seconds:.3f}",
                )
            )
    if json is not None:
        write_json(json, {"machine": machine(), "images": images, "each": results})
    print(table(rows, left=(0, 1)))
    print(f"{images} images each; {machine()}")
