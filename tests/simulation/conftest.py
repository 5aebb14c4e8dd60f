"""The suite that every engine has to pass is a module of its own; pytest rewrites its assertions, too."""

import pytest

pytest.register_assert_rewrite("engine_contract")
