"""Pages of a recorded episode, and of a result with filtering and replay of its episodes."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from fungrasp.core.errors import FungraspError
from fungrasp.evaluation import LiftTestResult, LiftTestSpec, ResultFile, Trajectory, replay
from fungrasp.grasps import RobotGraspSet, load_objects, load_robot_grasps
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel, load_object
from fungrasp.viewer.episode_stage import EpisodePlayer, EpisodeScene, place_in_front, recorded_states
from fungrasp.viewer.page import BrowserPage, add_table, look_at, values_table

if TYPE_CHECKING:
    from viser import ClientHandle


class RecordingPage(BrowserPage):
    """Page to scrub through an episode and replay it."""

    def __init__(
        self, client: ClientHandle, trajectory: Trajectory, objects: Mapping[str, ObjectModel] | None = None
    ):
        """
        Args:
            objects: objects by name; the built-in object if missing.
        """
        super().__init__(client)
        self._trajectory, self._objects = trajectory, objects or {}
        add_table(client)
        client.gui.add_markdown(f"**{trajectory.object_name}, {trajectory.hand}**")
        self._player = EpisodePlayer(self)
        self.worker.ask("show", self._show)

    def _show(self) -> None:
        show_recording(self, self._player, self._trajectory, self._objects)


def show_recording(
    page: BrowserPage, player: EpisodePlayer, trajectory: Trajectory, objects: Mapping[str, ObjectModel]
) -> None:
    """Show a recorded episode in a page.

    Raises:
        FungraspError: the hand or object is unknown.
    """
    hand = load_hand(trajectory.hand)
    name = trajectory.object_name
    model = objects[name] if name in objects else load_object(name)
    look_at(page.client, (0.0, 0.0, 0.12), 0.75)
    with page.client.atomic():
        place = place_in_front(trajectory.object_pose[0])
        scene = EpisodeScene(page.client.scene, f"/episode{id(trajectory)}", place, hand, model)
    player.begin(scene, recorded_states(trajectory))
    player.finish()
    player.status.content = "**success**" if trajectory.success else f"**failed: {trajectory.reason}**"


ALL, FAILED, HELD, OTHERWISE, AS_SHOWN = "all", "failed", "held", "held, not as shown", "held as shown"
"""Kinds of episodes."""
OUTCOMES = ("success", "reason", "held_as_shown", "not_as_shown", "place_error_mm")
"""Fields of ``Outcomes`` on a page."""
LISTED = 12
"""Number of episodes in the list at a time."""


@dataclass(frozen=True, eq=False)
class ShownResult:
    """A result with the sources of its episodes."""

    title: str
    """Hand, policy and protocol as text."""
    episodes: list[dict[str, Any]]
    """Episodes: index, object, task, seed, and the known fields in ``OUTCOMES``."""
    spec: LiftTestSpec | None = None
    """Settings of the test; None in old results."""
    grasps: RobotGraspSet | None = None
    """Tested grasps, if available."""
    objects: Mapping[str, ObjectModel] = field(default_factory=dict)
    """Objects of the grasps by name."""
    recordings: Path | None = None
    """Folder of recorded episodes."""
    missing: str = ""
    """Why episodes can't be simulated again; "" if they can."""

    @classmethod
    def of(cls, result: LiftTestResult) -> Self:
        """Create from a result of ``evaluate``."""
        episodes = [
            {
                "index": int(result.index[i]),
                "object": str(result.object_name[i]),
                "task": str(result.task[i]),
                "seed": int(result.seed[i]),
                **{name: getattr(result.outcomes, name)[i].item() for name in OUTCOMES},
            }
            for i in range(len(result.index))
        ]
        title = f"{result.hand}, policy {result.policy}, protocol {result.spec.protocol}"
        return cls(title, episodes, result.spec, result.grasps, result.objects)

    @classmethod
    def read(cls, path: Path, file: ResultFile) -> Self:
        """Create from a result file. Grasps, objects and recordings are searched at the paths in its command.

        Raises:
            FungraspError: the file is not a result of a lift test.
        """
        header = file.header
        rows = [row for row in file.rows if {"index", "object", "success"} <= set(row)]
        if not rows:
            raise FungraspError(f"{path} holds no episodes of a lift test")
        title = f"{header.get('hand', '')}, policy {header.get('policy', '')}, {header.get('protocol', '')}"
        options = _options(str(header.get("command", "")))
        spec = header.get("spec")
        missing, grasps, objects = "", None, {}
        recordings = _beside(path, options.get("--record"))
        try:
            where = _beside(path, options.get("--grasps"))
            if where is None:
                raise FungraspError("the grasp file was moved or deleted")
            grasps = load_robot_grasps(where)
            objects = load_objects(grasps, _beside(path, options.get("--objects")))
        except FungraspError as error:
            missing = str(error)
        read = None if spec is None else LiftTestSpec.read(spec, f"{path}: spec")
        return cls(title, rows, read, grasps, objects, recordings, missing)


class ResultPage(BrowserPage):
    """Page of the episodes of a lift test."""

    def __init__(self, client: ClientHandle, shown: ShownResult):
        super().__init__(client)
        self._shown, self._first = shown, 0
        add_table(client)
        look_at(client, (0.0, 0.0, 0.12), 0.75)
        gui, episodes = client.gui, shown.episodes
        kinds = [_kind(e) for e in episodes]
        held = f"{sum(kind != FAILED for kind in kinds)} of {len(episodes)} held"
        known = HELD not in kinds and any(kind != FAILED for kind in kinds)
        held += f", {kinds.count(AS_SHOWN)} as shown" if known else ""
        gui.add_markdown(f"**{shown.title}**\n\n{held}")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Episodes"):
            self._outcome = gui.add_dropdown("Outcome", [ALL, FAILED, HELD, OTHERWISE, AS_SHOWN])
            self._object = gui.add_dropdown("Object", [ALL, *sorted({str(e["object"]) for e in episodes})])
            reasons = sorted({_reason(e) for e in episodes} - {""})
            self._reason = gui.add_dropdown("Reason", [ALL, *reasons])
            self._count = gui.add_markdown("")
            self._list = [gui.add_button("–", visible=False, color="gray") for _ in range(LISTED)]
            self._pages = gui.add_button_group("More", ("earlier", "later"))
        with tabs.add_tab("Replay"):
            self._player = EpisodePlayer(self)
        with tabs.add_tab("By object"):
            gui.add_markdown(_by_object(episodes))
        for control in (self._outcome, self._object, self._reason):
            control.on_update(lambda _: self._filter())
        self._pages.on_click(lambda _: self._turn(1 if self._pages.value == "later" else -1))
        for number, button in enumerate(self._list):
            button.on_click(lambda _, number=number: self.worker.ask("replay", lambda: self._replay(number)))
        self._filter()

    def _rows(self) -> list[dict[str, Any]]:
        rows = self._shown.episodes
        if self._outcome.value != ALL:
            # HELD includes both kinds of held episodes.
            wanted = self._outcome.value
            rows = [e for e in rows if wanted == _kind(e) or (wanted == HELD and e["success"])]
        if self._object.value != ALL:
            rows = [e for e in rows if e["object"] == self._object.value]
        if self._reason.value != ALL:
            rows = [e for e in rows if _reason(e) == self._reason.value]
        return rows

    def _filter(self) -> None:
        self._first = 0
        self._show_list()

    def _turn(self, step: int) -> None:
        last = max((len(self._rows()) - 1) // LISTED, 0)
        self._first = LISTED * min(max(self._first // LISTED + step, 0), last)
        self._show_list()

    def _show_list(self) -> None:
        rows = self._rows()
        here = rows[self._first : self._first + LISTED]
        with self.client.atomic():
            for button, row in zip(self._list, [*here, *[None] * LISTED], strict=False):
                button.visible = row is not None
                if row is not None:
                    kind = _kind(row)
                    error = row.get("place_error_mm") if kind in (OTHERWISE, AS_SHOWN) else None
                    how = kind if error is None else f"{kind}, {error:.0f} mm"
                    how += f": {row.get('reason') or '?'}" if kind == FAILED else ""
                    button.label = f"{row['index']} {row['object']} {row.get('task') or ''}: {how}"
                    button.color = "red" if kind == FAILED else "orange" if kind == OTHERWISE else "green"
            end = self._first + len(here)
            self._count.content = f"{len(rows)} episodes" + (
                f", {self._first + 1} to {end} here; click one to play it" if rows else ""
            )

    def _replay(self, number: int) -> None:
        rows = self._rows()
        if self._first + number >= len(rows):
            return
        row, shown = rows[self._first + number], self._shown
        self._player.status.content = f"*{row['object']}, row {row['index']} …*"
        recorded = self._recording(row)
        if recorded is not None:
            show_recording(self, self._player, replay(recorded), shown.objects)
            self.note("recorded episode: it is in the tab Replay")
            return
        if shown.grasps is None or shown.spec is None:
            raise FungraspError(
                "this episode was not recorded, and can't be simulated again: "
                f"{shown.missing or 'the result is old'}; evaluate --record FOLDER keeps episodes"
            )
        self.note("not recorded: it is simulated again from its seed")
        self._simulate(row)

    def _recording(self, row: dict[str, Any]) -> Path | None:
        folder = self._shown.recordings
        if folder is None:
            return None
        names = (
            f"{row['index']:04d}_{row['object']}.npz",
            f"{row['index']:04d}_{row.get('seed', 0)}_{row['object']}.npz",
        )
        part = str(row.get("part", "")).rpartition("/")[2].replace(",", "").replace(" ", "-")
        places = (folder / name for name in names), (folder / part / name for name in names)
        return next((file for group in places for file in group if file.is_file()), None)

    def _simulate(self, row: dict[str, Any]) -> None:
        shown = self._shown
        grasps, spec = shown.grasps, shown.spec
        assert grasps is not None and spec is not None
        # Random parameters depend only on seed and row, so other episodes are not needed.
        spec = replace(spec, seeds=(int(row.get("seed", 0)),), attempts=1, use=False, static=False)
        with TemporaryDirectory() as folder:
            again = evaluate_row(grasps, shown.objects, spec, int(row["index"]), Path(folder))
            show_recording(self, self._player, replay(again), shown.objects)


def evaluate_row(
    grasps: RobotGraspSet, objects: Mapping[str, ObjectModel], spec: LiftTestSpec, row: int, folder: Path
) -> Path:
    """Repeat the episode of one row exactly and return its recording.

    Raises:
        FungraspError: as ``evaluate``.
    """
    from fungrasp.evaluation.lift_episodes import Episodes, LiftTest

    test = LiftTest(grasps, objects, grasps.load_hand(), spec, record=folder, threads=1)
    condition = next(iter(spec.conditions))
    test.simulate(Episodes(condition, spec.seeds[0], np.array([row])), lambda done: None)
    return next(folder.rglob("*.npz"))


def _kind(episode: Mapping[str, Any]) -> str:
    """Return the kind of an episode: ``HELD`` if the human contact points are unknown."""
    if not episode["success"]:
        return FAILED
    error = episode.get("place_error_mm")
    if error is None or not np.isfinite(error):
        return HELD
    return AS_SHOWN if episode.get("held_as_shown") else OTHERWISE


def _reason(episode: Mapping[str, Any]) -> str:
    """Return why an episode failed or was not held as shown, or ""."""
    return str(episode.get("reason") or episode.get("not_as_shown") or "")


def _by_object(episodes: list[dict[str, Any]]) -> str:
    rows = []
    for name in sorted({str(e["object"]) for e in episodes}):
        kinds = [_kind(e) for e in episodes if e["object"] == name]
        held = sum(kind != FAILED for kind in kinds)
        rows.append((name, f"{held} of {len(kinds)}", str(kinds.count(AS_SHOWN))))
    return values_table(rows, ("object", "held", "as shown"))


def _options(command: str) -> dict[str, str]:
    """Return the options of a command line that have a value."""
    try:
        words = shlex.split(command)
    except ValueError:
        return {}
    pairs = [word.partition("=") for word in words if word.startswith("--") and "=" in word]
    found = {name: value for name, _, value in pairs}
    found |= {a: b for a, b in pairwise(words) if a.startswith("--") and not b.startswith("--")}
    return found


def _beside(result: Path, name: str | None) -> Path | None:
    """Return the existing path for ``name``: as given or beside the result, or None."""
    if name is None:
        return None
    for path in (Path(name), result.parent / name, result.parent / Path(name).name):
        if path.exists():
            return path
    return None
