"""Tools of the kitchen, the workshop and the desk, a book and a ball."""

from __future__ import annotations

import numpy as np

from benchmarks.builtin_objects.assembly import PartSolids
from benchmarks.builtin_objects.shapes import (
    Solid,
    along_x,
    along_y,
    box,
    ellipse,
    eye,
    mirrored,
    moved,
    prism,
    ring,
    sweep,
    turned,
)
from fungrasp.objects.builtin_objects import lathe


def pan(
    bottom: float = 0.09,  # Radius of the floor [m]
    top: float = 0.12,  # Radius of the rim [m]
    depth: float = 0.045,  # Depth of the pan [m]
    handle: float = 0.18,  # Length of the handle [m]
) -> PartSolids:
    """A frying pan; the handle points to +x."""
    b, t, d = bottom, top, depth
    floor = 0.004
    start, end = t - 0.006, t + handle
    bar = [
        ellipse((start, 0, d - 0.013), (0, 0.013, 0), (0, 0, 0.0045), squareness=3),
        ellipse((start + 0.05, 0, d), (0, 0.0095, 0), (0, 0, 0.0065), squareness=2.5),
        ellipse((end - 0.06, 0, d + 0.012), (0, 0.0125, 0), (0, 0, 0.0085), squareness=2.5),
        ellipse((end - 0.008, 0, d + 0.013), (0, 0.012, 0), (0, 0, 0.008), squareness=2.5),
        ellipse((end, 0, d + 0.013), (0, 0.008, 0), (0, 0, 0.005), squareness=2.5),
    ]
    return {
        "body": [
            lathe([(b - 0.002, 0), (b, 0.001), (b + 0.003, floor)], segments=56),
            *ring(
                [(b + 0.003, floor), (b + 0.014, d * 0.4), (t, d)],
                [(b - 0.001, floor), (t - 0.004, d)],
                pieces=14,
            ),
        ],
        "handle": sweep(bar),
    }


def knife(
    blade: float = 0.19,  # Length of the blade [m]
    handle: float = 0.12,  # Length of the handle [m]
    width: float = 0.042,  # Width of the blade at the heel [m]
    spine_thickness: float = 0.0024,  # Thickness of the blade at its back [m]
) -> PartSolids:
    """A chef's knife lying on its side; the blade points to +x, its edge to -y."""
    length, w, thick = blade, width, spine_thickness
    back = 0.012
    spine = [(0.0, back), (length * 0.6, back - 0.001), (length, back - 0.018)]
    edge = [
        (0.012, back - w),
        (length * 0.45, back - w + 0.002),
        (length * 0.8, back - w + 0.012),
        (length, back - 0.019),
    ]
    points = [(x, y, s * thick / 2) for x, y in spine for s in (-1, 1)]
    points += [(x, y, s * 0.0002) for x, y in edge for s in (-1, 1)]
    points += [(0.0, back - w + 0.006, s * thick / 2 * 0.6) for s in (-1, 1)]
    grip = [
        ellipse((-handle, -0.004, 0), (0, 0.011, 0), (0, 0, 0.0075), squareness=2.6),
        ellipse((-handle + 0.008, -0.003, 0), (0, 0.0155, 0), (0, 0, 0.0095), squareness=2.6),
        ellipse((-handle * 0.55, 0.0, 0), (0, 0.0125, 0), (0, 0, 0.0095), squareness=2.6),
        ellipse((-0.022, 0.0005, 0), (0, 0.0115, 0), (0, 0, 0.0085), squareness=2.6),
        ellipse((0.006, -0.002, 0), (0, 0.014, 0), (0, 0, 0.0075), squareness=2.6),
    ]
    return {"handle": sweep(grip), "blade": [np.array(points)]}


def bowl(
    radius: float = 0.075,  # Radius of the rim [m]
    height: float = 0.06,  # Height of the bowl [m]
    wall: float = 0.0045,  # Thickness at the rim [m]
) -> PartSolids:
    """A soup bowl."""
    r, h, w = radius, height, wall
    foot, floor, middle, lip = 0.036, 0.008, 0.028, h - 0.01
    outer_middle, outer_lip = r * 0.87, r * 0.985
    inner_middle = outer_middle - w - 0.002
    inner_lip = inner_middle + (r - w - inner_middle) * (lip - middle) / (h - middle)
    return {
        "body": [
            lathe([(foot - 0.002, 0), (foot, 0.001), (foot + 0.012, floor)], segments=48),
            *ring(
                [(foot + 0.012, floor), (outer_middle - 0.004, 0.0225), (outer_middle, middle)],
                [(foot + 0.002, floor), (inner_middle, middle)],
            ),
            *ring([(outer_middle, middle), (outer_lip, lip)], [(inner_middle, middle), (inner_lip, lip)]),
        ],
        "rim": ring([(outer_lip, lip), (r, h - 0.001), (r - 0.001, h)], [(inner_lip, lip), (r - w, h)]),
    }


def spatula(
    handle: float = 0.13,  # Length of the grip [m]
    shaft_length: float = 0.11,  # Length of the bar between grip and blade [m]
    blade_length: float = 0.09,  # Length of the blade [m]
) -> PartSolids:
    """A turner lying on the table; the blade points to +x."""
    bend = shaft_length + 0.01
    plate = [
        (bend, -0.02), (bend, 0.02), (bend + blade_length, -0.041), (bend + blade_length, 0.041),
        (bend + 0.02, -0.037), (bend + 0.02, 0.037),
    ]  # fmt: skip
    blade = np.array([(x, y, z) for x, y in plate for z in (0.0, 0.0018)])
    grip = [
        ellipse((x, 0, z), (0, a, 0), (0, 0, b), squareness=3)
        for x, z, a, b in (
            (-handle, 0.022, 0.010, 0.005),
            (-handle + 0.008, 0.022, 0.0145, 0.0085),
            (-0.05, 0.022, 0.0105, 0.0085),
            (0.0, 0.022, 0.0125, 0.008),
        )
    ]
    shaft = [
        ellipse((-0.004, 0, 0.022), (0, 0.005, 0), (0, 0, 0.0025), corners=12, squareness=3),
        ellipse((shaft_length * 0.8, 0, 0.014), (0, 0.005, 0), (0, 0, 0.0025), corners=12, squareness=3),
        ellipse((bend + 0.012, 0, 0.0022), (0, 0.007, 0), (0, 0, 0.0016), corners=12, squareness=3),
    ]
    return {"handle": sweep(grip), "shaft": sweep(shaft), "blade": [blade]}


def brush(
    handle: float = 0.18,  # Length of the handle [m]
    head: float = 0.075,  # Length of the head [m]
    bristles: float = 0.026,  # Length of the bristles [m]
) -> PartSolids:
    """A dish brush lying on its bristles; the head points to +x."""
    back, length = bristles, head
    bar = [
        ellipse((x, 0, z), (0, a, 0), (0, 0, b), squareness=3)
        for x, z, a, b in (
            (-handle, 0.030, 0.008, 0.005),
            (-handle + 0.01, 0.031, 0.0125, 0.0085),
            (-handle * 0.55, 0.036, 0.0115, 0.0085),
            (-0.045, 0.037, 0.0085, 0.007),
            (0.012, back + 0.006, 0.014, 0.0055),
        )
    ]
    middle = length / 2
    plate = np.concatenate(
        [
            ellipse((middle, 0, z), (middle - cut, 0, 0), (0, 0.026 - cut, 0), corners=28, squareness=3.5)
            for z, cut in ((back, 0.001), (back + 0.003, 0), (back + 0.008, 0), (back + 0.011, 0.004))
        ]
    )
    tuft = np.concatenate(
        [
            ellipse((middle, 0, 0), (middle - 0.002, 0, 0), (0, 0.025, 0), corners=28, squareness=3.5),
            ellipse(
                (middle, 0, back + 0.001),
                (middle - 0.006, 0, 0),
                (0, 0.021, 0),
                corners=28,
                squareness=3.5,
            ),
        ]
    )
    return {"handle": sweep(bar), "head": [plate], "bristles": [tuft]}


def hammer(
    length: float = 0.32,  # Length of the hammer [m]
    grip_length: float = 0.14,  # Length of the rubber grip [m]
    face: float = 0.0145,  # Radius of the striking face [m]
) -> PartSolids:
    """A claw hammer lying on its side; the head is at +x, its face points to -y and the claw to +y."""
    head = length - 0.014
    grip = [
        ellipse((x, 0, 0), (0, a, 0), (0, 0, b), squareness=2.4)
        for x, a, b in (
            (0, 0.014, 0.011),
            (0.006, 0.0185, 0.014),
            (0.03, 0.0175, 0.0135),
            (grip_length * 0.65, 0.0155, 0.0125),
            (grip_length, 0.0165, 0.0125),
        )
    ]
    shaft = [
        ellipse((grip_length - 0.002, 0, 0), (0, 0.0135, 0), (0, 0, 0.0095), squareness=2.2),
        ellipse((head, 0, 0), (0, 0.0105, 0), (0, 0, 0.0085), squareness=2.2),
    ]
    poll = [
        lathe([(0.0105, -0.03), (0.0105, -0.012)], segments=24),
        lathe(
            [(face - 0.001, -0.056), (face, -0.054), (face, -0.033), (0.0105, -0.028)],
            segments=32,
        ),
    ]
    return {
        "grip": sweep(grip),
        "shaft": sweep(shaft),
        "head": [
            box((0.027, 0.034, 0.025), (head, 0, 0), bevel=0.003),
            *(moved(along_y(solid), x=head) for solid in poll),
            *(moved(solid, x=head) for side in (-1, 1) for solid in _hammer_claw(side)),
        ],
    }


def _hammer_claw(side: int) -> list[Solid]:
    """One prong of the claw, bent towards the grip."""
    rows = [  # y, x, half-thickness along x, inner and outer edge along z
        (0.012, 0.0, 0.0105, 0.0, 0.0115),
        (0.034, -0.003, 0.0085, 0.0012, 0.0135),
        (0.052, -0.011, 0.005, 0.003, 0.0135),
        (0.068, -0.024, 0.0014, 0.0045, 0.0125),
    ]
    sections = [
        np.array(
            [
                (x + s * t + s * t * 0.5 * (y > 0.04), y - s * t * 0.6 * (y > 0.04), side * z)
                for s in (-1, 1)
                for z in zs
            ]
        )
        for y, x, t, *zs in rows
    ]
    return sweep(sections)


def screwdriver(
    handle: float = 0.105,  # Length of the handle [m]
    shaft_length: float = 0.115,  # Length of the bare shaft [m]
    radius: float = 0.016,  # Radius of the six-sided handle [m]
) -> PartSolids:
    """A screwdriver lying on the table; the tip points to +x."""
    r, n = radius, handle
    profile = [
        (0.55, 0),
        (0.86, 0.004),
        (1.0, 0.012),
        (1.0, 0.052),
        (0.68, 0.078),
        (0.68, 0.084),
        (0.86, 0.097),
        (0.6, n),
    ]
    sections = [_screwdriver_flats(r * k, z) for k, z in profile]
    shaft = [lathe([(0.0032, n - 0.006), (0.0032, n + shaft_length - 0.012)], segments=16)]
    tip = np.concatenate(
        [
            ellipse((0, 0, n + shaft_length - 0.013), (0.0032, 0, 0), (0, 0.0032, 0), corners=16),
            ellipse((0, 0, n + shaft_length), (0.0005, 0, 0), (0, 0.0034, 0), corners=8, squareness=6),
        ]
    )
    grip = [np.concatenate(sections[:4]), *sweep(sections[3:])]
    return {"handle": [along_x(s) for s in grip], "shaft": [along_x(s) for s in (*shaft, tip)]}


def _screwdriver_flats(radius: float, height: float) -> np.ndarray:
    """A hexagon with cut corners, one flat below."""
    angles = np.deg2rad([60 * k + d for k in range(6) for d in (-20, 20)])
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(12, height)])


def drill(
    height: float = 0.215,  # Height of the drill [m]
    barrel: float = 0.029,  # Radius of the motor housing [m]
) -> PartSolids:
    """A cordless drill standing on its battery; the chuck points to +x."""
    axis = height - barrel
    r = barrel
    under = axis - r + 0.006
    grip = [
        ellipse((x, 0, z), (a, 0, 0), (0, b, 0), corners=20, squareness=2.5)
        for z, x, a, b in (
            (0.046, -0.012, 0.022, 0.017),
            (0.085, -0.018, 0.0195, 0.0155),
            (0.125, -0.016, 0.0185, 0.016),
            (under, -0.008, 0.026, 0.0175),
        )
    ]
    trigger = [
        ellipse((0.012, 0, under - 0.002), (0.010, 0, 0), (0, 0.009, 0), squareness=3),
        ellipse((0.009, 0, under - 0.014), (0.0085, 0, 0), (0, 0.009, 0), squareness=3),
        ellipse((0.005, 0, under - 0.03), (0.010, 0, 0), (0, 0.0085, 0), squareness=3),
    ]
    housing = [
        lathe(
            [(r - 0.01, -0.073), (r - 0.002, -0.066), (r, -0.055), (r, 0.03), (r - 0.005, 0.044)],
            segments=36,
        ),
        lathe([(r - 0.006, 0.042), (r - 0.007, 0.064)], segments=36),
    ]
    chuck = [
        lathe([(0.0195, 0.063), (0.0205, 0.066), (0.0205, 0.088), (0.0185, 0.092)], segments=28),
        lathe([(0.0185, 0.092), (0.0095, 0.108), (0.0085, 0.109)], segments=28),
    ]
    return {
        "grip": sweep(grip),
        "trigger": sweep(trigger),
        "body": [moved(along_x(s), z=axis) for s in housing],
        "chuck": [moved(along_x(s), z=axis) for s in chuck],
        "battery": [
            box((0.112, 0.070, 0.034), (0.0, 0, 0.017), bevel=0.004),
            box((0.098, 0.058, 0.018), (-0.001, 0, 0.041), bevel=0.004),
        ],
    }


def clamp(
    handle: float = 0.095,  # Length of a handle [m]
    jaw: float = 0.07,  # Length of a jaw [m]
    spread: float = 0.3,  # Angle between a handle and the middle line [rad]
    thickness: float = 0.026,  # Along z [m]
) -> PartSolids:
    """A spring clamp lying flat and closed; the jaws point to +x."""
    t = thickness / 2
    side = {"jaws": _clamp_jaw(jaw, t), "handles": _clamp_handle(handle, spread, t)}
    both = {name: [*solids, *(mirrored(s) for s in solids)] for name, solids in side.items()}
    return {**both, "pivot": [lathe([(0.0125, -t + 0.001), (0.0125, t - 0.001)], segments=28)]}


def _clamp_jaw(jaw: float, t: float) -> list[Solid]:
    length = jaw
    arm = [
        prism(
            [(-0.004, 0.006), (-0.004, 0.017), (length * 0.55, 0.026), (length * 0.55, 0.014)],
            -t * 0.8,
            t * 0.8,
            0.0015,
        ),
        prism(
            [
                (length * 0.55, 0.014),
                (length * 0.55, 0.026),
                (length * 0.8, 0.024),
                (length, 0.012),
                (length, 0.006),
            ],
            -t * 0.8,
            t * 0.8,
            0.0015,
        ),
    ]
    pad = prism(
        [
            (length - 0.022, 0.0002),
            (length + 0.002, 0.0002),
            (length + 0.002, 0.009),
            (length - 0.022, 0.0125),
        ],
        -t,
        t,
    )
    return [*arm, pad]


def _clamp_handle(handle: float, spread: float, t: float) -> list[Solid]:
    sections = [
        ellipse((x, y, 0), (0, a, 0), (0, 0, b), squareness=3.5)
        for x, y, a, b in (
            (0.004, -0.009, 0.006, t * 0.8),
            (-handle * 0.35, -0.015, 0.0065, t * 0.85),
            (-handle * 0.93, -0.0155, 0.0075, t),
            (-handle, -0.0155, 0.005, t * 0.7),
        )
    ]
    return [turned(solid, spread) for solid in sweep(sections)]


def flashlight(
    radius: float = 0.0145,  # Radius of the body [m]
    length: float = 0.15,  # Length of the flashlight [m]
) -> PartSolids:
    """A torch lying on the table; the light points to +x."""
    r, n = radius, length
    body = [
        lathe([(r - 0.002, 0), (r, 0.002), (r, 0.016)], segments=32),
        lathe([(r - 0.001, 0.016), (r - 0.001, 0.1)], segments=32),
    ]
    head = [
        lathe([(r - 0.001, 0.098), (r + 0.006, 0.122), (r + 0.006, n - 0.002), (r + 0.005, n)], segments=36),
    ]
    return {
        "body": [along_x(s) for s in body],
        "head": [along_x(s) for s in head],
        "switch": [box((0.014, 0.009, 0.006), (0.075, 0, r - 0.001), bevel=0.001)],
    }


def scissors(
    blade_length: float = 0.095,  # From the screw to the tip [m]
    opening: float = 0.12,  # Half the angle between the blades [rad]
    thickness: float = 0.003,  # Thickness of one blade [m]
    bar: float = 0.005,  # Half the thickness of the loops [m]
) -> PartSolids:
    """Scissors lying flat, a little open; the blades point to +x, drawn around the screw."""
    blade, loop = _scissors_half(blade_length, opening, thickness, bar)
    return {
        "loops": [*loop, *(mirrored(s) for s in loop)],
        "blades": [*blade, *(mirrored(s) for s in blade)],
    }


def _scissors_half(
    blade_length: float, opening: float, thickness: float, bar: float
) -> tuple[list[Solid], list[Solid]]:
    """The upper blade, on the +y side, and its loop on the -y side."""
    t = thickness
    tip = [
        (-0.012, -0.007),
        (-0.012, 0.006),
        (0.01, 0.0095),
        (blade_length * 0.6, 0.0085),
        (blade_length, 0.0012),
        (blade_length, -0.0005),
    ]
    shank = [(-0.012, 0.006), (-0.012, -0.007), (-0.045, -0.0115), (-0.045, -0.0015)]
    blade = [prism([*tip, (0.0, -0.007)], 0.0, t), prism(shank, -bar * 0.6, bar * 0.9, 0.001)]
    loop = eye((-0.079, -0.0125, 0), (0.0355, 0.0195), (0.0048, bar))
    return [turned(s, opening) for s in blade], [turned(s, opening) for s in loop]


def marker(
    radius: float = 0.0085,  # Radius of the barrel [m]
    length: float = 0.125,  # Length of the marker [m]
) -> PartSolids:
    """A felt pen with its cap on, lying; the cap points to +x."""
    r, n = radius, length
    joint = n * 0.62
    barrel = [lathe([(r - 0.003, 0), (r - 0.0005, 0.006), (r, 0.02), (r, joint)], segments=28)]
    cap = [
        lathe(
            [(r + 0.0005, joint), (r + 0.0008, joint + 0.001), (r - 0.0005, n - 0.006), (r - 0.003, n)],
            segments=28,
        ),
    ]
    return {"barrel": [along_x(s) for s in barrel], "cap": [along_x(s) for s in cap]}


def book(
    size: tuple[float, float, float] = (0.13, 0.2, 0.028),  # Width, height of the page, thickness [m]
    board: float = 0.0025,  # Thickness of the cover [m]
) -> PartSolids:
    """A hardcover book lying on its back; the spine is at -x."""
    w, h, t = size
    b = board
    return {
        "cover": [
            box((w, h, b), (0, 0, b / 2)),
            box((w, h, b), (0, 0, t - b / 2)),
            box((b, h, t), (-w / 2 + b / 2, 0, t / 2)),
        ],
        "pages": [box((w - 0.006, h - 0.006, t - 2 * b + 0.0002), (-0.002, 0, t / 2))],
    }


def ball(
    radius: float = 0.0335,  # Radius of the ball [m]
) -> PartSolids:
    """A ball."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, 15)[1:-1]
    poles = np.array([(0, 0, radius), (0, 0, -radius)])
    rounds = lathe([(radius * np.cos(a), radius * np.sin(a)) for a in angles], segments=28)
    return {"ball": [np.concatenate([rounds, poles])]}
