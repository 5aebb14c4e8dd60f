"""``python -m benchmarks.speed drivers``: what the drivers of robots cost."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from fungrasp.cli.console import table


@dataclass(frozen=True)
class BenchRobot:
    """Measure what the drivers cost and how fast they answer, against emulated devices."""

    devices: tuple[str, ...] = ()
    """Devices to measure: ur, allegro-v4, allegro-v5, inspire, inspire-serial, inspire-eb90, leap; all by
    default."""
    seconds: float = 5.0
    """Of measuring each [s]."""
    json: Path | None = None
    """Write the numbers here (.json, with a .csv beside)."""

    def run(self) -> None:
        from benchmarks.speed.driver_throughput import driver_speed
        from fungrasp.core.provenance import machine, run_record
        from fungrasp.evaluation.result_files import write_result
        from fungrasp.robots.process_priority import raise_priority
        from fungrasp_emulators.devices import EMULATED, known_devices

        # Real devices don't wait for a computer's other work.
        raise_priority()
        speeds = [driver_speed(EMULATED[name](20.0), self.seconds) for name in known_devices(self.devices)]
        if self.json is not None:
            write_result(self.json, run_record(0), [asdict(speed) for speed in speeds])
        head = (
            "device",
            "connect [s]",
            "steps/s",
            "of a core",
            "process",
            "command [us]",
            "read [us]",
            "age [ms]",
        )
        rows = [
            (
                s.device,
                f"{s.connect:.2f}",
                f"{s.rate:.0f}",
                f"{s.busy_share:.1%}",
                f"{s.process_share:.1%}",
                f"{1e6 * s.command:.0f}",
                f"{1e6 * s.read:.0f}",
                f"{1e3 * s.age:.1f}",
            )
            for s in speeds
        ]
        print(table([head, *rows]))
        print(f"against emulated devices, which share this machine; {machine()}")
