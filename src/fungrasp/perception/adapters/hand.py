"""One hand, in metres, from a file that another program left."""

from __future__ import annotations

import logging
from pathlib import Path

from fungrasp.errors import FungraspError
from fungrasp.formats.guarded import guarded
from fungrasp.perception.adapters.hand_fields import read_fields
from fungrasp.perception.adapters.hand_file import hands_of
from fungrasp.perception.adapters.placing import place_hand
from fungrasp.perception.estimates import HandEstimate, Side
from fungrasp.perception.hand.landmarks import choose_hand
from fungrasp.perception.io.capture import Capture

_log = logging.getLogger(__name__)


@guarded("hand file")
def read_hand(
    path: str | Path,
    capture: Capture,
    *,
    side: Side | None = None,
    hand: int | None = None,
    mano: str | Path | None = None,
) -> HandEstimate:
    """Read a hand that HaMeR, WiLoR, METRO or another program found in the capture's colour image.

    The file is JSON or ``.npz`` with named arrays; docs/adapters.md says which. Size and distance of the hand
    are not taken from it but measured in the depth image (see ``place_hand``), unless it says ``metric``.

    Args:
        path: the file.
        capture: the image that the program saw, with its depth.
        side: which hand is meant, if the file has several.
        hand: which one, counted from 0; by default the one nearest to the capture's box, or the largest.
        mano: the user's MANO model (folder or file), for files without joints.

    Returns:
        Joints in the camera frame, with covariances; a left hand is not mirrored.

    Raises:
        FungraspError: the file can't be read, lacks something, or is not of this image; there is no depth at
            the hand.
    """
    fields = read_fields(path)
    hands = hands_of(fields, capture.intrinsics, mano)
    if hand is not None:
        if not 0 <= hand < len(hands):
            raise FungraspError(f"{path} has {len(hands)} hands, counted from 0; there is no hand {hand}")
        hands = [hands[hand]]
    if not hands:
        raise FungraspError(f"{path} has no hand")
    chosen, note = choose_hand(hands, capture.box, side)
    if note:
        _log.warning("%s: %s", path, note)
    return place_hand(chosen, capture, keep_size=fields.flag("metric", False))
