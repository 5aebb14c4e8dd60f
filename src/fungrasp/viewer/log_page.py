"""The page of a deployment's log: where hand and object were, setpoints, and what happened."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fungrasp.deployment.log import RecordedDeployment
from fungrasp.errors import FungraspError
from fungrasp.hands import load_hand
from fungrasp.objects import load_object
from fungrasp.viewer.episode_stage import EpisodePlayer, EpisodeScene, place_in_front
from fungrasp.viewer.episode_states import EpisodeState, EpisodeStates
from fungrasp.viewer.page import BrowserPage, add_table, look_at

if TYPE_CHECKING:
    from viser import ClientHandle

PHASES = {"approach": "approach", "lift": "lift", "hold": "hold"}
"""Phases of a deployment that episodes have too; all else counts as approach."""


def check_log(log: RecordedDeployment, path: Path) -> None:
    """
    Raises:
        FungraspError: there is nothing in it to show.
    """
    if log.plan is None:
        raise FungraspError(f"{path} ends before a plan was made: there is nothing to show")
    if not log.messages["/setpoint"]:
        raise FungraspError(f"{path} holds no setpoint: there is nothing to show")


class LogPage(BrowserPage):
    """A deployment."""

    def __init__(self, client: ClientHandle, log: RecordedDeployment):
        """
        Args:
            client: the browser.
            log: with a plan and setpoints.
        """
        super().__init__(client)
        self._log = log
        add_table(client, 2.0)
        about = "\n".join(f"- {name}: {value}" for name, value in log.about.items())
        whole = "" if log.complete else "\n\n**It breaks off: its writer was killed, or the disk was full.**"
        client.gui.add_markdown(f"**Deployment**{whole}\n\n{about}")
        self._events = client.gui.add_dropdown("Event", ["none"], hint="Jump to where it happened")
        self._player = EpisodePlayer(self)
        self._events.on_update(lambda _: self._jump())
        self._times: dict[str, float] = {}
        self.worker.ask("show", self._show)

    def _show(self) -> None:
        log = self._log
        plan = log.plan
        assert plan is not None
        hand, name = load_hand(plan.hand), str(plan.object_name[0])
        frames, start = logged_states(log, hand.all_joints, plan.object_pose[0])
        look_at(self.client, (0.0, 0.0, 0.15), 0.9)
        try:
            model = load_object(name)
        except FungraspError as error:
            raise FungraspError(f"the object of the log is no built-in one ({error})") from error
        with self.client.atomic():
            place = place_in_front(plan.object_pose[0])
            scene = EpisodeScene(self.client.scene, "/deployment", place, hand, model)
        self._player.begin(scene, frames)
        self._player.finish()
        faults = [event["text"] for event in log.messages["/event"] if event["what"] == "fault"]
        self._player.status.content = f"**fault: {faults[0]}**" if faults else "no fault"
        for event in log.messages["/event"]:
            time = max(float(event["time"]) - start, 0.0)
            self._times[f"{time:.1f} s {event['what']}: {event['text']}"] = time
        self._events.options = ["none", *self._times]

    def _jump(self) -> None:
        time = self._times.get(str(self._events.value))
        if time is not None:
            self._player.go_to(time)


def logged_states(
    log: RecordedDeployment, all_joints, object_pose: np.ndarray
) -> tuple[EpisodeStates, float]:
    """Frames of a log, and the time at which it begins.

    Args:
        log: with setpoints.
        all_joints: gives all joints of the hand from the driven ones.
        object_pose: where the object is as long as it is not tracked, shape [7].
    """
    setpoints, steps = log.messages["/setpoint"], log.messages["/step"]
    start = float(setpoints[0]["time"])
    step_times = np.array([float(step["time"]) for step in steps])
    frames, thing = EpisodeStates(), np.asarray(object_pose, dtype=float)
    links = log.plan.link_contacts.shape[1] if log.plan is not None else 0
    for message in setpoints:
        time = float(message["time"])
        commanded = np.asarray(message["sent"]["palm"], dtype=float)
        palm = commanded
        before = int(np.searchsorted(step_times, time, side="right")) - 1
        if before >= 0:
            # The measured palm is known at control steps; in between the command leads on from it.
            seen = np.asarray(steps[before]["observation"]["palm_pose"], dtype=float)
            palm = seen
        thing = thing if message["object"] is None else np.asarray(message["object"], dtype=float)
        frames.add(
            EpisodeState(
                time - start,
                PHASES.get(str(message["phase"]), "approach"),
                thing,
                palm,
                all_joints(np.asarray(message["hand"]["positions"], dtype=float)),
                np.zeros(links, dtype=bool),
                commanded_palm=commanded,
                commanded_joints=all_joints(np.asarray(message["sent"]["hand"], dtype=float)),
            )
        )
    return frames, start
