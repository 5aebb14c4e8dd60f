import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.perception import HandEstimate, ObjectEstimate

POSE = np.array([0, 0, 0.6, 1, 0, 0, 0.0])


def a_hand(**changes) -> HandEstimate:
    fields = {
        "joints_camera": np.ones((21, 3)),
        "pixels": np.ones((21, 2)),
        "confidence": np.ones(21),
        "covariance": np.tile(np.eye(3), (21, 1, 1)),
        "side": "right",
        "score": 0.9,
    }
    return HandEstimate(**{**fields, **changes})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"joints_camera": np.ones((20, 3))}, r"joints_camera must have shape \[21, 3\], not \[20, 3\]"),
        ({"covariance": np.ones((21, 3))}, "covariance"),
        ({"pixels": np.full((21, 2), np.nan)}, "pixels has non-finite"),
        ({"side": "Right"}, "side"),
        ({"score": 1.2}, "score"),
    ],
)
def test_a_hand_is_checked(changes, words):
    assert a_hand().side == "right"
    with pytest.raises(FungraspError, match=words):
        a_hand(**changes)


def test_an_object_and_its_alternatives_are_checked():
    estimate = ObjectEstimate(POSE, 0.8, True, ((POSE, 0.4),), residual_m=0.001)
    assert estimate.alternatives[0][1] == 0.4
    with pytest.raises(FungraspError, match="score"):
        ObjectEstimate(POSE, 0.8, True, ((POSE, 1.4),))
    with pytest.raises(FungraspError, match="pose"):
        ObjectEstimate(POSE[:6], 0.8, True)
