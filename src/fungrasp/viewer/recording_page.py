"""The page of one recorded episode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from fungrasp.evaluation import Trajectory
from fungrasp.hands import load_hand
from fungrasp.objects import ObjectModel, load_object
from fungrasp.viewer.episode_stage import EpisodePlayer, EpisodeScene, place_in_front
from fungrasp.viewer.episode_states import recorded_states
from fungrasp.viewer.page import BrowserPage, add_table, look_at

if TYPE_CHECKING:
    from viser import ClientHandle


class RecordingPage(BrowserPage):
    """Scrub through an episode, and play it again."""

    def __init__(
        self, client: ClientHandle, trajectory: Trajectory, objects: Mapping[str, ObjectModel] | None = None
    ):
        """
        Args:
            client: the browser.
            trajectory: the episode.
            objects: by name; a built-in object if None.
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
    """Put a recorded episode into a page.

    Raises:
        FungraspError: no such hand or object.
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
