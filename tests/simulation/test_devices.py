"""Devices, what they need, and one line where it is missing; no GPU and none of its packages are needed."""

from __future__ import annotations

import ctypes
from importlib.metadata import PackageNotFoundError

import pytest
from engine_contract import contract_scene

from fungrasp.core.errors import FungraspError
from fungrasp.simulation import BufferSizes, MujocoCpuEngine, devices, found_device, make_engine, warp_device
from fungrasp.simulation.warp_device import probe_buffer_sizes


class Driver:
    """A driver of NVIDIA's with so many GPUs, of a version of CUDA."""

    def __init__(self, count: int, version: int = 12040, fails: int = 0):
        self.count, self.version, self.fails = count, version, fails

    def cuInit(self, _: int) -> int:
        return self.fails

    def cuDeviceGetCount(self, number: object) -> int:
        number._obj.value = self.count
        return 0

    def cuDriverGetVersion(self, number: object) -> int:
        number._obj.value = self.version
        return 0


@pytest.fixture
def packages(monkeypatch):
    """Versions that are found; names that are missing are not installed."""
    found = {"mujoco-warp": "4.0.0", "mujoco": "4.0.0", "mujoco-core": "4.0.0", "warp-lang": "1.19.0"}

    def version(name: str) -> str:
        if name not in found:
            raise PackageNotFoundError(name)
        return found[name]

    monkeypatch.setattr(warp_device, "version", version)
    monkeypatch.setattr(warp_device, "find_spec", lambda name: object())
    return found


def test_a_device_that_is_given_is_taken_and_without_a_gpu_it_is_the_processor(monkeypatch):
    monkeypatch.setattr(devices, "cuda_devices", lambda: 0)
    assert found_device() == "cpu" and found_device("cpu-warp") == "cpu-warp"
    with pytest.raises(FungraspError, match=r"device 'gpu'.*cuda"):
        found_device("gpu")


def test_a_gpu_is_found_if_its_packages_are_there(monkeypatch):
    monkeypatch.setattr(devices, "cuda_devices", lambda: 2)
    monkeypatch.setattr(devices, "find_spec", lambda name: object())
    assert found_device() == "cuda"
    monkeypatch.setattr(devices, "find_spec", lambda name: None)
    assert found_device() == "cpu"


@pytest.mark.parametrize(
    ("driver", "words"),
    [
        (None, "no NVIDIA driver"),
        (Driver(1, 11080), r"knows CUDA 11\.8, and Warp needs 12"),
        (Driver(1, fails=100), "nvidia-smi"),
        (Driver(0), "CUDA_VISIBLE_DEVICES"),
    ],
)
def test_why_there_is_no_gpu_is_said_in_a_line(monkeypatch, driver, words):
    monkeypatch.setattr(warp_device, "cuda_driver", lambda: driver)
    with pytest.raises(FungraspError, match=words):
        raise FungraspError(warp_device.why_no_cuda())
    monkeypatch.setattr(devices, "cuda_driver", lambda: driver)
    devices.cuda_devices.cache_clear()
    assert devices.cuda_devices() == (1 if driver is not None and not driver.fails and driver.count else 0)
    devices.cuda_devices.cache_clear()


def test_the_driver_is_asked_without_any_package():
    assert isinstance(devices.cuda_driver(), ctypes.CDLL | None)


@pytest.mark.parametrize(
    ("name", "version", "words"),
    [
        ("mujoco-warp", "3.9.1", r"mujoco-warp 4\.0\.x, not 3\.9\.1"),
        ("mujoco", "3.17.0", r"mujoco 4\.x, not 3\.17\.0"),
        ("warp-lang", None, r"warp-lang 1\.19\.x, not none.*\.\[gpu\]"),
        ("mujoco-core", "4.0.1", r"of one version, not 4\.0\.0, 4\.0\.1: pip install mujoco==4\.0\.1"),
    ],
)
def test_packages_that_do_not_fit_together_are_refused(packages, name, version, words):
    if version is None:
        del packages[name]
    else:
        packages[name] = version
    with pytest.raises(FungraspError, match=words):
        warp_device.check_warp_packages("cuda")


def test_an_engine_that_is_not_installed_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(warp_device, "find_spec", lambda name: None)
    with pytest.raises(FungraspError, match=r'warp, which is not installed: pip install "\.\[gpu\]"'):
        warp_device.check_warp_packages("cuda")


def test_buffers_have_room():
    with pytest.raises(FungraspError, match="at least one contact"):
        BufferSizes(0, 10)
    assert BufferSizes(10, 10).pool(100) == 1000 and BufferSizes(10, 10).pool(1) == 40


def test_a_probe_finds_what_a_hand_around_an_object_needs():
    """The figures of whole episodes, 71 contacts and 300 rows at most, fit."""
    found = probe_buffer_sizes(contract_scene())
    assert 71 <= found.contacts <= 200 and 300 <= found.rows <= 1000


def test_the_cpu_engine_is_made_where_nothing_else_is_said():
    engine = make_engine(contract_scene(), 1, 1)
    assert isinstance(engine, MujocoCpuEngine) and engine.problems() == []
