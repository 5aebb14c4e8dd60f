"""What a policy's name stands for."""

import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.policies.registry import KINDS, policy_source


@pytest.mark.parametrize(
    ("kind", "commands"),
    [("teacher", ["train"]), ("student", ["train", "distill"])],
)
def test_kinds_that_do_not_come_for_a_hand_say_what_makes_them(kind, commands):
    assert kind in KINDS
    with pytest.raises(FungraspError, match="'my_hand'") as refused:
        policy_source(kind, "my_hand")
    assert all(f"fungrasp {command}" in str(refused.value) for command in commands)


def test_a_policy_that_is_neither_a_name_nor_a_file_is_refused():
    with pytest.raises(FungraspError, match="not int"):
        policy_source(3, "allegro")  # type: ignore[arg-type]
