"""Running a policy's graph in many worlds at once, on ONNX Runtime."""

from __future__ import annotations

import os
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.policies.checkpoint.card import PolicyCard

OBSERVATION, ACTION = "observation", "action"
STATE, NEXT_STATE = "state_", "next_state_"
"""An input that starts with the one is followed, at the next step, by the output that starts with the
other."""
TYPES: Mapping[str, Any] = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
    "tensor(bool)": np.bool_,
}
"""Types of a state's numbers."""
NAMED = 5
"""Most worlds to name in an error."""

State = dict[str, np.ndarray]
"""What a policy remembers, by name; the first axis of each array is the world, shape [W, ...]."""


class PolicyNetwork:
    """A policy's graph with its card. It keeps nothing between calls: its memory is handed in and out."""

    def __init__(self, model: bytes, card: PolicyCard, threads: int = 1):
        """
        Args:
            model: an ONNX file. Inputs ``observation`` [W, O] and any ``state_<x>`` [W, ...]; outputs
                ``action`` [W, A], a ``next_state_<x>`` for each state, and any others. W must be left open.
            card: what it says about itself.
            threads: that compute one step.

        Raises:
            FungraspError: ONNX Runtime is missing or refuses the graph, or the graph is not as the card says.
        """
        self.card = card
        self._size = card.input_size
        self._session = _session(model, threads)
        inputs = {put.name: put for put in self._session.get_inputs()}
        self._outputs = [put.name for put in self._session.get_outputs()]
        _check_vector(inputs.pop(OBSERVATION, None), OBSERVATION, card.input_size)
        actions = {put.name: put for put in self._session.get_outputs()}
        _check_vector(actions.get(ACTION), ACTION, card.action_size)
        self._states: dict[str, tuple[Any, tuple[int, ...]]] = {}
        for name, put in inputs.items():
            if not name.startswith(STATE):
                raise FungraspError(
                    f"the graph has an input '{name}'; there may be '{OBSERVATION}' and '{STATE}...'"
                )
            if NEXT_STATE + name.removeprefix(STATE) not in self._outputs:
                raise FungraspError(f"the graph has an input '{name}' and no output 'next_{name}'")
            _check_open(put)
            if put.type not in TYPES or not all(isinstance(size, int) for size in put.shape[1:]):
                raise FungraspError(
                    f"the graph's input '{name}' has no fixed shape and number type per world"
                )
            self._states[name.removeprefix(STATE)] = TYPES[put.type], tuple(put.shape[1:])
        for name in self._outputs:
            if name.startswith(NEXT_STATE) and name.removeprefix(NEXT_STATE) not in self._states:
                raise FungraspError(f"the graph has an output '{name}' and no input '{name[5:]}'")

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of what the graph says besides the action and the next state."""
        return tuple(name for name in self._outputs if name != ACTION and not name.startswith(NEXT_STATE))

    def initial_state(self, worlds: int) -> State:
        """What it remembers at the start of an episode: zeros, shape [worlds, ...] each. A policy without
        memory has an empty one."""
        return {name: np.zeros((worlds, *shape), kind) for name, (kind, shape) in self._states.items()}

    def __call__(
        self, observation: np.ndarray, state: Mapping[str, np.ndarray] | None = None
    ) -> tuple[np.ndarray, dict[str, np.ndarray], State]:
        """One step in W worlds.

        Args:
            observation: the card's ``inputs`` in a row, not normalised, shape [W, O].
            state: from ``initial_state`` or the step before; only a policy without memory needs none.

        Returns:
            The action, shape [W, A], as the graph gives it, neither scaled nor smoothed; the graph's other
            outputs by name ("contacts", "forces", ...), each [W, ...]; the state for the next step.

        Raises:
            FungraspError: a wrong shape or state, a number that is NaN or infinite (in or out), or the graph
                can't be computed.
        """
        observation = self._checked(observation)
        worlds = len(observation)
        feed = {OBSERVATION: observation}
        state = state or {}
        if set(state) != set(self._states):
            raise FungraspError(
                f"{self._name} remembers {_list(self._states)}, the given state has {_list(state)}"
            )
        for name, (kind, shape) in self._states.items():
            if np.shape(state[name]) != (worlds, *shape):
                raise FungraspError(
                    f"state '{name}' of {self._name} must have shape {(worlds, *shape)}, "
                    f"not {np.shape(state[name])}"
                )
            feed[STATE + name] = np.ascontiguousarray(state[name], dtype=kind)
        try:
            values = self._session.run(self._outputs, feed)
        except Exception as error:
            raise FungraspError(f"{self._name} can't run: {' '.join(str(error).split())}") from error
        outputs = dict(zip(self._outputs, values, strict=True))
        action = outputs.pop(ACTION)
        self._refuse_infinite("gave an action with", action, self.card.action)
        after = {name: outputs.pop(NEXT_STATE + name) for name in self._states}
        return action, outputs, after

    @property
    def _name(self) -> str:
        return f"policy '{self.card.name}'"

    def _checked(self, observation: np.ndarray) -> np.ndarray:
        """The array in single precision, after a check of its shape and that it is finite."""
        given = np.asarray(observation)
        if given.ndim != 2 or given.shape[1] != self._size:
            layout = ", ".join(f"{part.name} {part.size}" for part in self.card.inputs)
            raise FungraspError(
                f"{self._name} takes observations of shape [W, {self.card.input_size}] ({layout}), "
                f"not {list(given.shape)}"
            )
        single = given
        if given.dtype != np.float32 or not given.flags.c_contiguous:
            with np.errstate(over="ignore"):
                single = np.ascontiguousarray(given, dtype=np.float32)
        self._refuse_infinite("was given", single, self.card.inputs)
        return single

    def _refuse_infinite(self, verb: str, values: np.ndarray, parts: tuple[Any, ...]) -> None:
        finite = np.isfinite(values)
        if finite.all():
            return
        columns = np.flatnonzero(~finite.all(axis=0))
        names = [part.name for part in parts for _ in range(part.size)]
        found = _list(dict.fromkeys(names[column] for column in columns))
        worlds = np.flatnonzero(~finite.all(axis=1))
        more = f" and {len(worlds) - NAMED} more" if len(worlds) > NAMED else ""
        where = ", ".join(str(world) for world in worlds[:NAMED])
        raise FungraspError(
            f"{self._name} {verb} NaN or infinite numbers in {found}, "
            f"world{'s' * (len(worlds) > 1)} {where}{more}"
        )


def onnx_runtime() -> ModuleType:
    """The package ``onnxruntime``, its telemetry off.

    Raises:
        FungraspError: it is not installed.
    """
    # The library reads it once, when it is loaded.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    try:
        import onnxruntime
    except ImportError as error:
        raise FungraspError(
            "a learned policy runs on ONNX Runtime, which is not installed: pip install onnxruntime "
            '(training also needs: pip install "fungrasp[learning]")'
        ) from error
    onnxruntime.disable_telemetry_events()
    return onnxruntime


def _session(model: bytes, threads: int) -> Any:
    runtime = onnx_runtime()
    if threads < 1:
        raise FungraspError(f"a policy needs at least one thread, not {threads}")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    options.add_session_config_entry("session.load_model_format", "ONNX")
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # Weights must lie in the file itself: others would be looked for in a folder that can't exist.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", os.devnull)
    try:
        return runtime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise FungraspError(f"ONNX Runtime can't run it: {' '.join(str(error).split())}") from error


def _check_vector(put: Any, name: str, size: int) -> None:
    if put is None:
        raise FungraspError(f"the graph has no '{name}'")
    _check_open(put)
    if put.type != "tensor(float)" or put.shape[1:] != [size]:
        raise FungraspError(
            f"the graph's '{name}' is {put.type} {put.shape}; by its card it should be float [W, {size}]"
        )


def _check_open(put: Any) -> None:
    if not put.shape or isinstance(put.shape[0], int):
        raise FungraspError(
            f"the graph's '{put.name}' has shape {put.shape}; its first axis, the world, must be left open"
        )


def _list(names: Any) -> str:
    return ", ".join(f"'{name}'" for name in names) or "nothing"
