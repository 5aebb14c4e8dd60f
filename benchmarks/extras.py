"""Each optional extra alone, from nothing: ``python3 -m benchmarks.extras [EXTRA ...] [--wheel FILE]``.

For each extra a virtual environment is made, and the wheel installed with that extra and no other; the
command that the extra is for must work there. In one more environment, with no extra, the same command must
end with status 2 and say in one line which extra is missing. Needs Python 3.11 and a package index alone.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]

GRASPS = """
from fungrasp.grasps import builtin_grasps, save_human_grasps
save_human_grasps("few.npz", builtin_grasps().select([0, 1]))
"""
IMAGE = """
from pathlib import Path
from PIL import Image
Path("images").mkdir()
Path("images/arm.json").write_text('{"a.png": [0, 0, 0, 0, 0, 0]}')
Path("images/camera.json").write_text('{"width": 64, "height": 48, "fx": 60, "fy": 60, "cx": 32, "cy": 24}')
Image.new("RGB", (64, 48)).save("images/a.png")
"""
STEP = """
rows = [(0.02 * i, 1000 if i < 10 else 300, 1000 if i < 14 else max(300, 1840 - 60 * i)) for i in range(80)]
text = "".join("%.2f,%d,%d\\n" % row for row in rows)
open("step.csv", "w").write("time_s,target_value,measured_value\\n" + text)
"""
SEQUENCE = """
from pathlib import Path
Path("dexycb/subject/sequence").mkdir(parents=True)
Path("dexycb/subject/sequence/meta.yml").write_text("{}")
"""
RECORDED = """
import fungrasp
human = fungrasp.builtin_grasps()[:1]
objects = fungrasp.load_objects(human)
fungrasp.evaluate(fungrasp.retarget(human, objects, "allegro"), objects, "reference", record="episodes")
"""
WORLDS = """
from fungrasp.training.gymnasium_env import LiftEnv
LiftEnv(grasps="few.npz").reset(seed=0)
"""
MANO = """
from fungrasp.grasps.importers.mano import ManoHand
ManoHand("nowhere")
"""
PAGE = """
import fungrasp
fungrasp.view("few.npz", port=0, wait=False).close()
"""


def script(code: str) -> str:
    """Python code that writes ``script.py``, which ends as commands do."""
    lines = "".join(f"    {line}\n" for line in code.strip().splitlines())
    end = "    print('fungrasp: error:', error, file=sys.stderr)\n    sys.exit(2)\n"
    text = f"import sys\ntry:\n{lines}except ValueError as error:\n{end}"
    return f"open('script.py', 'w').write({text!r})\n"


def client(module: str, extra: str) -> Trial:
    """The client library of a device."""
    code = "from fungrasp.robots.optional_packages import import_client\n"
    return Trial("python script.py", script(f"{code}import_client({module!r}, {extra!r}, 'the device')"))


class Trial(NamedTuple):
    """The command that an extra is for."""

    command: str
    """Words of the command; ``python`` and ``fungrasp`` are those of the environment."""
    prepare: str = ""
    """Python code that writes the command's files, with the package and no extra."""
    ends_with: str = ""
    """What the command says at last where the rest needs a device or files that are not ours; by default it
    must end with status 0."""
    setup: str = ""
    """A command that is run before, where the extra is installed."""


TRIALS = {
    "allegro": client("can", "allegro"),
    "bench": Trial(
        "python -m benchmarks.peers --grasps few.npz --method dex-retargeting dexi-rs mink", GRASPS
    ),
    "calibration": Trial(
        "fungrasp robots calibrate ur5e-allegro --images images --out c.toml", IMAGE, ends_with="board"
    ),
    "deploy": Trial("fungrasp deploy --robot ur5e-allegro --policy plan --fast --log lift.mcap"),
    "drake": Trial("python -m benchmarks.engines audit episodes --engine drake", RECORDED),
    "dexycb": Trial(
        "fungrasp grasps import dexycb dexycb --out d.npz",
        SEQUENCE,
        ends_with="the field 'serials' is missing",
    ),
    # Kernels are compiled first, which takes minutes.
    "gpu": Trial("fungrasp evaluate --grasps few.npz --device cpu-warp --json result.json", GRASPS),
    "gymnasium": Trial("python script.py", GRASPS + script(WORLDS)),
    "inspire": client("pymodbus", "inspire"),
    "leap": client("dynamixel_sdk", "leap"),
    "learning": Trial(
        "fungrasp train --out t --grasps few.npz --steps 100 --environment.worlds 4 --variety.copies 1",
        GRASPS,
    ),
    "lerobot": Trial("fungrasp export episodes --out dataset", RECORDED),
    # Every command that needs MANO needs its licensed files first.
    "mano": Trial("python script.py", script(MANO), ends_with="does not exist"),
    "perception": Trial("fungrasp demo --from-image", setup="fungrasp setup perception"),
    "pose": client("zmq", "pose"),
    "ray": Trial("fungrasp retarget --grasps few.npz --ray --out r.npz", GRASPS),
    "realsense": Trial("fungrasp perceive --camera --mesh mug --out g.npz", ends_with="camera|libusb"),
    "sysid": Trial("fungrasp identify fit step.csv --hand inspire --method cma-es --evaluations 30", STEP),
    "ur": client("ruckig", "ur"),
    "viewer": Trial("python script.py", GRASPS + script(PAGE)),
}
"""By extra; those of development, ``dev`` and ``docs``, are what ``make test`` installs."""


class ExtraError(Exception):
    """An extra is not enough, or a command does not say what it lacks."""


def main(arguments: list[str] | None = None) -> int:
    """The command line; the number of extras that fail."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("extras", nargs="*", help="all by default")
    parser.add_argument("--wheel", type=Path, help="of the package; built by default")
    options = parser.parse_args(arguments)
    if unknown := set(options.extras) - set(TRIALS):
        parser.error(f"unknown extra: {', '.join(sorted(unknown))}; there are {', '.join(TRIALS)}")
    failed = 0
    with tempfile.TemporaryDirectory(prefix="fungrasp-extras.") as name:
        folder = Path(name)
        bare = Environment(folder / "bare")
        wheel = options.wheel or bare.built_wheel()
        bare.install(str(wheel.absolute()))
        for extra in options.extras or TRIALS:
            try:
                said = _try(extra, bare, Environment(folder / extra), wheel.absolute())
                print(f"{extra}: works; without it: {said}", flush=True)
            except ExtraError as error:
                failed += 1
                print(f"{extra}: FAILED: {error}", flush=True)
    return failed


class Environment:
    """A virtual environment in a folder of its own, with an empty home."""

    def __init__(self, folder: Path):
        """folder: there is none yet."""
        self.work = folder / "work"
        self._python = folder / "venv" / "bin" / "python"
        (folder / "home").mkdir(parents=True)
        self.work.mkdir()
        hidden = ("PYTHONPATH", "VIRTUAL_ENV", "FUNGRASP")
        self._variables = {name: value for name, value in os.environ.items() if not name.startswith(hidden)}
        self._variables |= {"HOME": str(folder / "home"), "XDG_CACHE_HOME": str(folder / "home" / "cache")}
        self._variables |= {
            "PYTHONPATH": str(ROOT),
            "WANDB_MODE": "offline",
            "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        }
        self._check([sys.executable, "-m", "venv", str(folder / "venv")])

    def built_wheel(self) -> Path:
        """A wheel of this checkout."""
        self._check(
            [str(self._python), "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", "dist", str(ROOT)]
        )
        (wheel,) = (self.work / "dist").glob("*.whl")
        return wheel

    def install(self, what: str) -> None:
        """what: as pip takes it."""
        self._check([str(self._python), "-m", "pip", "install", "--quiet", what])

    def write(self, code: str) -> None:
        """Run Python code that writes files."""
        self._check([str(self._python), "-c", code])

    def run(self, command: str) -> subprocess.CompletedProcess[str]:
        """A command with the programs of this environment."""
        program, *words = command.split()
        return self._run([str(self._python.with_name(program)), *words])

    def _check(self, command: list[str]) -> None:
        done = self._run(command)
        if done.returncode:
            raise ExtraError(f"{' '.join(command)[:200]} ended with {done.returncode}: {done.stderr[-2000:]}")

    def _run(self, command: list[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command,
            cwd=self.work,
            env=self._variables,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=1200,
        )


def _try(extra: str, bare: Environment, own: Environment, wheel: Path) -> str:
    """What the command says without the extra.

    Raises:
        ExtraError: it does not name the extra, or fails with it.
    """
    trial = TRIALS[extra]
    for environment in (bare, own):
        if environment is own:
            own.install(f"{wheel}[{extra}]")
        if trial.prepare:
            environment.write(trial.prepare)
    without = bare.run(trial.command)
    lines = [line for line in without.stderr.splitlines() if line.startswith("fungrasp: error:")]
    wanted = f"pip install 'fungrasp[{extra}]'"
    if without.returncode != 2 or len(lines) != 1 or "Traceback" in without.stderr:
        raise ExtraError(
            f"without it, '{trial.command}' ended with {without.returncode}: {without.stderr[-2000:]}"
        )
    if wanted not in lines[0].replace('"', "'"):
        raise ExtraError(f"without it, '{trial.command}' does not say {wanted}: {lines[0]}")
    if trial.setup and (done := own.run(trial.setup)).returncode:
        raise ExtraError(f"'{trial.setup}' ended with {done.returncode}: {done.stderr[-2000:]}")
    done = own.run(trial.command)
    last = (done.stdout + done.stderr).strip().splitlines()[-1:]
    reached = bool(trial.ends_with and last and re.search(trial.ends_with, last[0]))
    if "Traceback" in done.stderr or (done.returncode and not reached):
        raise ExtraError(
            f"'{trial.command}' ended with {done.returncode}: {(done.stdout + done.stderr)[-2000:]}"
        )
    return lines[0].removeprefix("fungrasp: error: ")


if __name__ == "__main__":
    sys.exit(main())
