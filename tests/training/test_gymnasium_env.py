from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_match import check_environments_match

from fungrasp import builtin_grasps
from fungrasp.core.errors import FungraspError
from fungrasp.task.features import INPUT_LIMIT
from fungrasp.training.gymnasium_env import ID, LiftVectorEnv
from fungrasp.training.settings import EnvironmentSettings

FEW: dict[str, Any] = {
    "grasps": builtin_grasps().select(np.array([0, 3])),
    "settings": EnvironmentSettings(hold_time=0.3, whole=0.0, early=(4, 4)),
    "worlds": "nominal",
    "threads": 1,
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("privileged", [False, True])
def test_it_passes_gymnasiums_checker(privileged: bool) -> None:
    env = gymnasium.make(ID, privileged=privileged, **FEW)
    check_env(env.unwrapped, skip_render_check=True)
    assert ("contacts" in env.observation_space.spaces) is privileged  # type: ignore[attr-defined]


def test_the_same_seed_gives_the_same_episodes() -> None:
    check_environments_match(
        gymnasium.make(ID, **FEW), gymnasium.make(ID, **FEW), 30, seed=3, skip_render=True
    )


def test_many_worlds_end_and_begin_in_the_same_step() -> None:
    envs = gymnasium.make_vec(f"fungrasp.training.gymnasium_env:{ID}", num_envs=4, privileged=True, **FEW)
    assert isinstance(envs.unwrapped, LiftVectorEnv)
    seen, infos = envs.reset(seed=1)
    assert seen in envs.observation_space and not infos
    ended = 0
    before = seen
    for _ in range(80):
        actions = np.zeros(envs.action_space.shape or ())
        seen, reward, terminated, truncated, infos = envs.step(actions)
        assert seen in envs.observation_space and reward.shape == (4,) and not truncated.any()
        for w in np.flatnonzero(terminated):
            final = infos["final_obs"][w]
            assert final in envs.single_observation_space
            # The next episode's beginning is not the last one's end.
            assert not np.allclose(final["keypoint_errors"], seen["keypoint_errors"][w])
        assert ("final_obs" in infos) == terminated.any()
        if terminated.any():
            assert infos["_success"].tolist() == terminated.tolist()
        ended += int(terminated.sum())
        assert not np.array_equal(before["joints"], seen["joints"])
        before = seen
    assert ended >= 4


def test_a_seed_repeats_a_vector_environment() -> None:
    envs = LiftVectorEnv(2, **FEW)

    def some(seed: int) -> list[float]:
        envs.reset(seed=seed)
        actions = np.random.default_rng(0).uniform(-1, 1, (6, 2, envs.worlds.actions))
        return [float(r) for action in actions for r in envs.step(action)[1]]

    first = some(5)
    assert some(5) == first
    assert some(6) != first


def test_what_is_thrown_away_stays_within_the_bounds() -> None:
    envs = LiftVectorEnv(2, **FEW)
    envs.reset(seed=0)
    pose = envs.worlds.episodes.engine.object_pose
    pose[0, :3] = 1e5
    envs.worlds.episodes.engine.set_state(np.array([0]), object_pose=pose[:1])
    seen, *_ = envs.step(np.zeros((2, envs.worlds.actions)))
    assert seen in envs.observation_space
    assert max(float(np.abs(value).max()) for value in seen.values()) <= INPUT_LIMIT


def test_grasps_of_another_hand_and_unknown_worlds() -> None:
    with pytest.raises(FungraspError, match="nominal"):
        LiftVectorEnv(1, grasps=FEW["grasps"], worlds="mars")
    with pytest.raises(FungraspError, match="does not exist"):
        LiftVectorEnv(1, grasps="nowhere.npz")
