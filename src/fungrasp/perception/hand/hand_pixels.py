"""What of an image shows the hand, once the object it holds and the table are known."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from fungrasp.grasps.human_hand import BONES
from fungrasp.perception.hand.hand_capsules import offsets_from_lines
from fungrasp.perception.hand.initial_skeleton import MIRROR_X
from fungrasp.perception.hand.object_contact import Surroundings
from fungrasp.perception.io.capture import Capture, Intrinsics

REACH = 0.12
"""What is seen farther than this from every joint of a first guess [m] is not this hand."""

OBJECT_NEAR = 0.006
"""What is seen so near to the known object's surface [m] is the object."""

TABLE_NEAR = 0.008
"""What is seen so low above the table [m] is the table."""

EDGE = 0.015
"""Where neighbouring pixels differ by more [m], a depth camera sees the mean of what is on both sides."""

POINTS = 400
"""Points of the hand that are looked at."""

FEW = 12
"""So many times as many are sorted: most show something else."""

BONE = 0.006
"""Points that are seen so near to a guessed hand's bones [m] show what colour it has."""

LEAST_SKIN = 40
"""From fewer points no colour is learnt."""

MOST_SKIN = 400
"""From more points no more is learnt."""

OTHER_COLOUR = 4.0
"""Colours farther from the skin's [standard deviations] are another thing's."""

COLOUR_SPREAD = 0.04
"""Least standard deviation of the skin's colour: logarithm of red over green, and blue over green."""


@dataclass(frozen=True, eq=False)
class HandView:
    """An image of a right hand with what is known about it; the mirror image if it is of a left one."""

    depth: np.ndarray
    """[m], shape [H, W]; NaN: none."""
    intrinsics: Intrinsics
    around: Surroundings
    """Object and table."""
    points: np.ndarray
    """Measured points that may show the hand or its arm [m], camera frame, shape [P, 3]."""

    def mirrored(self) -> HandView:
        """The same seen in a mirror that swaps left and right."""
        lens = dataclasses.replace(self.intrinsics, cx=self.intrinsics.width - 1 - self.intrinsics.cx)
        return HandView(self.depth[:, ::-1], lens, self.around.mirrored(), self.points * MIRROR_X)

    def depth_at(self, pixels: np.ndarray) -> np.ndarray:
        """Depth of the nearest pixel [m], NaN where there is none. pixels: shape [..., 2]."""
        height, width = self.depth.shape
        u, v = np.moveaxis(np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(int), -1, 0)
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        return np.where(inside, self.depth[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)], np.nan)


def look(capture: Capture, around: Surroundings, guesses: list[np.ndarray]) -> HandView:
    """Find the points of the hand.

    They are near a guess, neither object nor table, of the colour that most of what is seen at the guesses'
    bones has: landmarks that are wrong are on the hand nevertheless, or each on something else.

    Args:
        capture: the image.
        around: object and table, not mirrored.
        guesses: joints of hands that may be there, best first [m], camera frame, each of shape [21, 3].
    """
    depth = np.where(capture.depth > 0, capture.depth, np.nan)
    joints = np.concatenate(guesses)
    lens = capture.intrinsics
    pixels = lens.project(joints)
    margin = REACH * lens.fx / float(np.median(joints[:, 2]))
    edge = np.array([lens.width, lens.height])
    low = np.clip(np.nanmin(pixels, axis=0) - margin, 0, edge - 2).astype(int)
    high = np.clip(np.nanmax(pixels, axis=0) + margin, low + 2, edge).astype(int)
    window = np.s_[low[1] : high[1], low[0] : high[0]]
    crop = depth[window]
    rows, columns = np.nonzero(~_edges(crop) & np.isfinite(crop))
    step = max(1, len(rows) // (FEW * POINTS))
    rows, columns = rows[::step] + low[1], columns[::step] + low[0]
    points = lens.deproject(np.stack([columns, rows], axis=1), depth[rows, columns])
    colour = capture.colour[rows, columns]
    near = np.zeros(len(points), dtype=bool)
    for guess in guesses:
        near |= np.linalg.norm(points[:, None] - guess[::2], axis=-1).min(axis=1) < REACH
    near &= np.abs(around.object_distance(points)[0]) > OBJECT_NEAR
    table = around.table_distance(points)
    if table is not None:
        near &= table[0] > TABLE_NEAR
    points, colour, seen = points[near], colour[near], np.stack([columns, rows], axis=1)[near]
    bones = [lens.project(guess)[np.transpose(BONES)] for guess in guesses]
    reach = BONE * lens.fx / float(np.median(joints[:, 2]))
    points = points[_skin_coloured(seen, colour, bones, reach)]
    every = max(1, len(points) // POINTS)
    return HandView(depth, lens, around, points[::every])


def _edges(depth: np.ndarray) -> np.ndarray:
    """Pixels beside a jump in depth, bool, shape [h, w]."""
    jumps = np.zeros(depth.shape, dtype=bool)
    down, across = (np.abs(np.diff(depth, axis=axis)) > EDGE for axis in (0, 1))
    jumps[1:] |= down
    jumps[:-1] |= down
    jumps[:, 1:] |= across
    jumps[:, :-1] |= across
    return jumps


def _skin_coloured(
    pixels: np.ndarray, colour: np.ndarray, bones: list[np.ndarray], reach: float
) -> np.ndarray:
    """Which pixels have the colour of the hand, bool, shape [P].

    Args:
        pixels: shape [P, 2].
        colour: RGB, shape [P, 3].
        bones: of each guess, pixels of both ends, shape [2, B, 2].
        reach: pixels nearer than this to a bone may show it.
    """
    votes = np.zeros(len(pixels))
    for ends in bones:
        _, offset = offsets_from_lines(pixels, *ends)
        votes += (np.linalg.norm(offset, axis=-1) < reach).any(axis=1)
    on = np.flatnonzero(votes)
    if len(on) < LEAST_SKIN:
        return np.ones(len(pixels), dtype=bool)
    on = on[:: max(1, len(on) // MOST_SKIN)]
    red, green, blue = np.log(colour.astype(float) + 8.0).T
    tone = np.stack([red - green, blue - green], axis=1)
    apart = np.linalg.norm(tone[on, None] - tone[on], axis=-1) / COLOUR_SPREAD
    middle = tone[on[(np.exp(-0.5 * apart**2) @ votes[on]).argmax()]]
    alike = tone[on][np.linalg.norm(tone[on] - middle, axis=1) < OTHER_COLOUR * COLOUR_SPREAD]
    middle = np.median(alike, axis=0)
    spread = np.maximum(1.48 * np.median(np.abs(alike - middle), axis=0), COLOUR_SPREAD)
    return np.linalg.norm((tone - middle) / spread, axis=1) < OTHER_COLOUR
