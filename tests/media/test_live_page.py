"""The page with the camera's picture."""

import json
import urllib.error
import urllib.request

import numpy as np
import pytest
from PIL import Image

from fungrasp.core.errors import FungraspError
from fungrasp.media.live_page import MISSING, READY, LivePage
from fungrasp.objects import builtin_object
from fungrasp.perception.builtin_image import builtin_truth
from fungrasp.perception.camera.frames import CameraFrame
from fungrasp.perception.camera.live import LiveView
from fungrasp.perception.camera.readiness import FrameProblem, FrameReadiness
from fungrasp.perception.hand.detected_hand import DetectedHand
from fungrasp.perception.io.scene_folders import BUILTIN_CAPTURE as FOLDER
from fungrasp.perception.io.scene_folders import read_folder

TRUTH = builtin_truth()
SEEN = read_folder(FOLDER)
FRAME = CameraFrame(SEEN.color, SEEN.depth, SEEN.intrinsics, 0.0)
HAND = DetectedHand(SEEN.intrinsics.project(TRUTH.joints_camera), np.zeros((21, 3)), "right", 0.9, 0.9)
MODEL = builtin_object(TRUTH.object_name)


def fetched(address: str, **headers: str) -> bytes:
    request = urllib.request.Request(address, headers=headers)
    with urllib.request.urlopen(request, timeout=10) as answer:
        return answer.read()


def test_the_page_shows_the_picture_and_the_words(tmp_path):
    with LivePage(MODEL) as page:
        assert page.address.startswith("http://127.0.0.1:")
        assert b"picture.jpg" in fetched(page.address)
        with pytest.raises(urllib.error.HTTPError, match="404"):
            fetched(page.address + "picture.jpg")
        page.show(LiveView(FRAME, FrameReadiness((FrameProblem.of("no_hand"),)), None, None))
        state = json.loads(fetched(page.address + "state.json"))
        assert (state["words"], state["ready"], state["number"]) == ("no hand", False, 1)
        page.show(LiveView(FRAME, FrameReadiness((), HAND), TRUTH.pose_camera_object, 1.4))
        state = json.loads(fetched(page.address + "state.json"))
        assert (state["seconds_left"], state["ready"], state["number"]) == (2, True, 2)
        (tmp_path / "p.jpg").write_bytes(fetched(page.address + "picture.jpg?2"))
        assert Image.open(tmp_path / "p.jpg").size == (SEEN.intrinsics.width, SEEN.intrinsics.height)
        page.say("the picture is taken", done=True)
        assert json.loads(fetched(page.address + "state.json"))["done"] is True
        with pytest.raises(FungraspError, match="can't be served"):
            LivePage(MODEL, int(page.address.rsplit(":", 1)[1].strip("/"))).__enter__()


def test_other_names_of_this_computer_get_nothing():
    """A page of another origin whose name was made to point here sends its own name."""
    with LivePage(MODEL) as page, pytest.raises(urllib.error.HTTPError, match="403"):
        fetched(page.address + "state.json", Host="evil.example")


def test_hand_and_object_are_drawn():
    page = LivePage(MODEL)
    plain = page.drawn(LiveView(FRAME, FrameReadiness(()), None, None))
    np.testing.assert_array_equal(plain, SEEN.color)
    ready = page.drawn(LiveView(FRAME, FrameReadiness((), HAND), TRUTH.pose_camera_object, 3.0))
    drawn = (ready == READY).all(axis=-1)
    middle = np.rint(HAND.pixels[9]).astype(int)
    assert drawn[middle[1] - 2 : middle[1] + 3, middle[0] - 2 : middle[0] + 3].any(), "the skeleton"
    rows, columns = np.nonzero(drawn)
    low, high = (
        SEEN.intrinsics.project(TRUTH.joints_camera).min(0),
        SEEN.intrinsics.project(TRUTH.joints_camera).max(0),
    )
    outside = (columns < low[0] - 5) | (columns > high[0] + 5) | (rows < low[1] - 5) | (rows > high[1] + 5)
    assert outside.sum() > 20, "the object's outline"
    missing = page.drawn(LiveView(FRAME, FrameReadiness((FrameProblem.of("no_table"),), HAND), None, None))
    assert (missing == MISSING).all(axis=-1).any() and not (missing == READY).all(axis=-1).any()
