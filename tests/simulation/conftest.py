"""The suite that every engine has to pass is a module of its own; its assertions are rewritten as tests' are."""

import pytest

pytest.register_assert_rewrite("engine_contract")
