"""What the tests of evaluation lift."""

from __future__ import annotations

import pytest
from lifted_grasps import allegro_hand, good_grasps, grasped_objects


@pytest.fixture(scope="module")
def allegro():
    return allegro_hand()


@pytest.fixture(scope="module")
def things():
    return grasped_objects()


@pytest.fixture(scope="module")
def good():
    return good_grasps()
