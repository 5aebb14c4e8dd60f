"""Objects of random dimensions, of the kinds that robots drop: flat, heavy, thin, round, with a handle."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from benchmarks.builtin_objects import tools, vessels
from benchmarks.builtin_objects.assembly import PartSolids
from benchmarks.builtin_objects.shapes import (
    Solid,
    along_x,
    box,
    ellipse,
    ring,
    sweep,
)
from fungrasp.objects.builtin_objects import lathe

CERAMIC, GLASS_FILLED, PAPER, WATER = 2300.0, 1150.0, 730.0, 1000.0
"""Densities [kg/m3]: stoneware; plastic with glass fibers; a book's pages; what bottles hold."""


@dataclass(frozen=True)
class DrawnShape:
    """One object of random dimensions."""

    parts: PartSolids
    """Convex solids by the name of the part."""
    mass: float = 0.0
    """Mass [kg]; where it is 0, that of the mesh at ``density``."""
    density: float = 0.0
    """Density [kg/m3]."""
    tasks: Mapping[str, str] = field(default_factory=dict)
    """What the grasps of a part are for."""
    lies: bool = False
    """Whether it may lie on any of its faces."""


Draw = Callable[[np.random.Generator], DrawnShape]


def _plate(rng: np.random.Generator) -> DrawnShape:
    radius, height, wall = rng.uniform(0.075, 0.125), rng.uniform(0.014, 0.026), rng.uniform(0.004, 0.006)
    foot = 0.6 * radius
    floor = lathe([(foot - 0.001, 0), (foot, 0.001), (foot + 0.004, wall)], segments=48)
    rim = ring(
        [(foot + 0.004, wall), (radius, height - 0.002), (radius - 0.001, height)],
        [(foot - 0.002, wall), (radius - wall, height)],
    )
    return DrawnShape({"floor": [floor], "rim": rim}, density=CERAMIC, tasks={"rim": "serve"})


def _book(rng: np.random.Generator) -> DrawnShape:
    size = (rng.uniform(0.09, 0.16), rng.uniform(0.14, 0.23), rng.uniform(0.01, 0.04))
    return DrawnShape(tools.book(size), density=PAPER, tasks={"cover": "read"}, lies=True)


def _phone(rng: np.random.Generator) -> DrawnShape:
    size = (rng.uniform(0.13, 0.165), rng.uniform(0.062, 0.08), rng.uniform(0.0075, 0.014))
    return DrawnShape({"body": [box(size, bevel=0.0015)]}, rng.uniform(0.13, 0.25), tasks={"body": "call"})


def _spoon(rng: np.random.Generator) -> DrawnShape:
    """A serving spoon; its bowl is filled."""
    length, half, thick = rng.uniform(0.12, 0.2), rng.uniform(0.005, 0.009), rng.uniform(0.002, 0.004)
    bowl, width, depth = rng.uniform(0.05, 0.08), rng.uniform(0.036, 0.055), rng.uniform(0.008, 0.014)
    stem = [
        ellipse((-length, 0, depth + 0.016), (0, half, 0), (0, 0, thick), squareness=3),
        ellipse((-0.4 * length, 0, depth + 0.008), (0, 0.8 * half, 0), (0, 0, thick), squareness=3),
        ellipse((0.004, 0, depth - 0.001), (0, 0.6 * half, 0), (0, 0, 0.8 * thick), squareness=3),
    ]
    middle = bowl / 2
    head = np.concatenate(
        [
            ellipse((middle, 0, z), (k * middle, 0, 0), (0, k * width / 2, 0), corners=24)
            for z, k in ((0.0, 0.35), (0.3 * depth, 0.75), (depth, 1.0), (depth + 0.001, 0.97))
        ]
    )
    mass = rng.uniform(0.04, 0.12)
    return DrawnShape({"handle": sweep(stem), "bowl": [head]}, mass, tasks={"handle": "stir"})


def _scissors(rng: np.random.Generator) -> DrawnShape:
    shape = tools.scissors(
        blade_length=rng.uniform(0.07, 0.12), opening=rng.uniform(0.06, 0.25), bar=rng.uniform(0.004, 0.006)
    )
    return DrawnShape(shape, rng.uniform(0.05, 0.13), tasks={"loops": "cut", "blades": "hand over"})


def _board(rng: np.random.Generator) -> DrawnShape:
    """A small cutting board with a handle."""
    length, width, thick = rng.uniform(0.16, 0.24), rng.uniform(0.1, 0.16), rng.uniform(0.012, 0.02)
    grip, half = rng.uniform(0.09, 0.13), rng.uniform(0.013, 0.019)
    body = box((length, width, thick), (0, 0, thick / 2), bevel=0.002)
    handle = box((grip + 0.01, 2 * half, thick), (length / 2 + grip / 2 - 0.005, 0, thick / 2), bevel=0.002)
    return DrawnShape(
        {"board": [body], "handle": [handle]}, density=650.0, tasks={"handle": "serve", "board": "place"}
    )


def _block(rng: np.random.Generator) -> DrawnShape:
    size = (rng.uniform(0.05, 0.09), rng.uniform(0.05, 0.085), rng.uniform(0.1, 0.2))
    mass = min(size[0] * size[1] * size[2] * rng.uniform(700, 2000), 1.4)
    body = box(size, bevel=rng.uniform(0.001, 0.004))
    return DrawnShape({"body": [body]}, mass, tasks={"body": "carry"}, lies=True)


def _full_bottle(rng: np.random.Generator) -> DrawnShape:
    shape = vessels.bottle(radius=rng.uniform(0.03, 0.041), height=rng.uniform(0.19, 0.26))
    tasks = {"body": "pour", "neck": "hand over", "cap": "open"}
    return DrawnShape(shape, density=WATER, tasks=tasks, lies=True)


def _drill(rng: np.random.Generator) -> DrawnShape:
    shape = tools.drill(height=rng.uniform(0.19, 0.24), barrel=rng.uniform(0.025, 0.034))
    tasks = {"grip": "drill", "body": "hand over"}
    return DrawnShape(shape, rng.uniform(0.8, 1.4), tasks=tasks)


def _canister(rng: np.random.Generator) -> DrawnShape:
    radius, height = rng.uniform(0.033, 0.045), rng.uniform(0.11, 0.19)
    body = lathe([(radius - 0.002, 0), (radius, 0.002), (radius, height - 0.002), (radius - 0.002, height)])
    return DrawnShape({"body": [body]}, density=rng.uniform(900, 1400), tasks={"body": "pour"}, lies=True)


def _dumbbell(rng: np.random.Generator) -> DrawnShape:
    half, radius = rng.uniform(0.05, 0.065), rng.uniform(0.012, 0.017)
    end, width = rng.uniform(0.024, 0.036), rng.uniform(0.02, 0.035)
    bar = along_x(lathe([(radius, -half - 0.003), (radius, half + 0.003)], segments=32))
    heads = []
    for side in (-1, 1):
        inner, outer = sorted((side * half, side * (half + width)))
        heads.append(along_x(lathe([(end, inner), (end, outer)], segments=12)))
    return DrawnShape({"bar": [bar], "heads": heads}, rng.uniform(0.6, 1.3), tasks={"bar": "exercise"})


def _pen(rng: np.random.Generator) -> DrawnShape:
    shape = tools.marker(radius=rng.uniform(0.0045, 0.0105), length=rng.uniform(0.11, 0.155))
    tasks = {"barrel": "write", "cap": "open"}
    return DrawnShape(shape, rng.uniform(0.006, 0.03), tasks=tasks)


def _knife(rng: np.random.Generator) -> DrawnShape:
    shape = tools.knife(
        blade=rng.uniform(0.1, 0.21),
        handle=rng.uniform(0.1, 0.135),
        width=rng.uniform(0.03, 0.047),
        spine_thickness=rng.uniform(0.002, 0.003),
    )
    tasks = {"handle": "cut", "blade": "hand over"}
    return DrawnShape(shape, rng.uniform(0.08, 0.22), tasks=tasks)


def _screwdriver(rng: np.random.Generator) -> DrawnShape:
    shape = tools.screwdriver(
        handle=rng.uniform(0.09, 0.12), shaft_length=rng.uniform(0.07, 0.15), radius=rng.uniform(0.012, 0.018)
    )
    tasks = {"handle": "drive", "shaft": "hand over"}
    return DrawnShape(shape, rng.uniform(0.05, 0.15), tasks=tasks)


def _stick(rng: np.random.Generator) -> DrawnShape:
    """A brush for teeth or paint, a chopstick, a file: a bar that tapers, lying."""
    length, near, far = rng.uniform(0.14, 0.24), rng.uniform(0.005, 0.009), rng.uniform(0.003, 0.006)
    squareness = rng.uniform(2.0, 5.0)
    bar = [
        ellipse((x, 0, 0), (0, a, 0), (0, 0, b), squareness=squareness)
        for x, a, b in (
            (-length / 2, near, 0.8 * near),
            (0.0, 0.5 * (near + far), 0.8 * near),
            (length / 2, far, far),
        )
    ]
    return DrawnShape({"body": sweep(bar)}, rng.uniform(0.008, 0.05), tasks={"body": "write"})


def _flashlight(rng: np.random.Generator) -> DrawnShape:
    shape = tools.flashlight(radius=rng.uniform(0.011, 0.018), length=rng.uniform(0.135, 0.17))
    tasks = {"body": "light", "head": "hand over"}
    return DrawnShape(shape, rng.uniform(0.08, 0.22), tasks=tasks)


def _ball(rng: np.random.Generator) -> DrawnShape:
    radius = rng.uniform(0.02, 0.043)
    mass = min(4.19 * radius**3 * rng.uniform(200, 1100), 0.4)
    return DrawnShape(tools.ball(radius), mass, tasks={"ball": "throw"})


def _fruit(rng: np.random.Generator) -> DrawnShape:
    """An apple, a lemon, an egg: a body of revolution, lying."""
    radius, stretch, skew = rng.uniform(0.022, 0.042), rng.uniform(0.8, 1.6), rng.uniform(-0.15, 0.15)
    angles = np.linspace(-np.pi / 2, np.pi / 2, 15)
    outline = [
        (max(radius * np.cos(a) * (1 + skew * np.sin(a)), 0.0008), stretch * radius * np.sin(a))
        for a in angles
    ]
    return DrawnShape({"body": [along_x(lathe(outline, segments=28))]}, density=900.0, tasks={"body": "eat"})


def _lying_can(rng: np.random.Generator) -> DrawnShape:
    shape = vessels.can(radius=rng.uniform(0.026, 0.043), height=rng.uniform(0.06, 0.15))
    parts = {name: [along_x(s) for s in solids] for name, solids in shape.items()}
    tasks = {"body": "hand over"}
    return DrawnShape(parts, density=rng.uniform(300, 1050), tasks=tasks)


def _bowl(rng: np.random.Generator) -> DrawnShape:
    shape = tools.bowl(
        radius=rng.uniform(0.065, 0.09), height=rng.uniform(0.05, 0.075), wall=rng.uniform(0.0035, 0.0055)
    )
    tasks = {"rim": "eat", "body": "hand over"}
    return DrawnShape(shape, density=rng.uniform(900, 2300), tasks=tasks)


def _jar(rng: np.random.Generator) -> DrawnShape:
    radius, height = rng.uniform(0.03, 0.046), rng.uniform(0.06, 0.1)
    lid = 0.8 * radius
    body = lathe(
        [(radius - 0.004, 0), (radius, 0.005), (radius, 0.75 * height), (lid - 0.003, height - 0.012)]
    )
    top = lathe([(lid, height - 0.013), (lid, height)])
    tasks = {"body": "hand over", "lid": "open"}
    return DrawnShape({"body": [body], "lid": [top]}, density=GLASS_FILLED, tasks=tasks, lies=True)


def _mug(rng: np.random.Generator) -> DrawnShape:
    shape = vessels.mug(
        radius=rng.uniform(0.034, 0.046),
        height=rng.uniform(0.085, 0.12),
        wall=rng.uniform(0.0035, 0.006),
        reach=rng.uniform(0.028, 0.036),
    )
    tasks = {"handle": "drink", "rim": "place", "body": "hand over"}
    return DrawnShape(shape, density=CERAMIC, tasks=tasks)


def _pan(rng: np.random.Generator) -> DrawnShape:
    bottom = rng.uniform(0.06, 0.09)
    shape = tools.pan(
        bottom, bottom + rng.uniform(0.028, 0.034), rng.uniform(0.035, 0.055), rng.uniform(0.14, 0.19)
    )
    tasks = {"handle": "cook", "body": "wash"}
    return DrawnShape(shape, rng.uniform(0.35, 0.95), tasks=tasks)


def _pitcher(rng: np.random.Generator) -> DrawnShape:
    bottom = rng.uniform(0.045, 0.06)
    shape = vessels.pitcher(bottom, bottom + 0.01, rng.uniform(0.19, 0.24), rng.uniform(0.0035, 0.005))
    tasks = {"handle": "pour", "body": "hand over"}
    return DrawnShape(shape, rng.uniform(0.2, 0.6), tasks=tasks)


def _hammer(rng: np.random.Generator) -> DrawnShape:
    shape = tools.hammer(rng.uniform(0.26, 0.34), rng.uniform(0.11, 0.15), rng.uniform(0.012, 0.017))
    tasks = {"grip": "hammer", "shaft": "hand over"}
    return DrawnShape(shape, rng.uniform(0.35, 0.75), tasks=tasks)


def _basket(rng: np.random.Generator) -> DrawnShape:
    """A box with an upright bar handle across its top, as of a bucket, a toolbox or a flat iron."""
    length, width, height = rng.uniform(0.13, 0.18), rng.uniform(0.07, 0.1), rng.uniform(0.05, 0.09)
    lift, radius = rng.uniform(0.052, 0.065), rng.uniform(0.009, 0.014)
    body = box((length, width, height), (0, 0, height / 2), bevel=0.003)
    half, top = 0.42 * length, height + lift
    bar = along_x(lathe([(radius, -half), (radius, half)], segments=20)) + np.array([0, 0, top])
    posts: list[Solid] = [
        box((2 * radius, 1.6 * radius, lift + 0.004), (side * (half - radius), 0, height + lift / 2 - 0.002))
        for side in (-1, 1)
    ]
    mass = rng.uniform(0.3, 0.9)
    return DrawnShape(
        {"body": [body], "handle": [bar], "posts": posts}, mass, tasks={"handle": "carry", "body": "place"}
    )


DRAWN_KINDS: Mapping[str, Mapping[str, Draw]] = {
    "flat": {
        "plate": _plate,
        "book": _book,
        "phone": _phone,
        "spoon": _spoon,
        "scissors": _scissors,
        "board": _board,
    },
    "heavy": {
        "block": _block,
        "full bottle": _full_bottle,
        "drill": _drill,
        "canister": _canister,
        "dumbbell": _dumbbell,
    },
    "thin": {
        "pen": _pen,
        "knife": _knife,
        "screwdriver": _screwdriver,
        "stick": _stick,
        "flashlight": _flashlight,
    },
    "round": {"ball": _ball, "fruit": _fruit, "lying can": _lying_can, "bowl": _bowl, "jar": _jar},
    "handled": {"mug": _mug, "pan": _pan, "pitcher": _pitcher, "hammer": _hammer, "basket": _basket},
}
"""Shapes by kind and name."""
