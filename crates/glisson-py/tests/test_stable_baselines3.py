"""Batches of environments in Stable-Baselines3, where it is there."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from gymnasium.vector import AutoresetMode  # noqa: E402
from stable_baselines3 import PPO  # noqa: E402

from glisson.envs import make_vec  # noqa: E402
from glisson.envs.stable_baselines3 import StableVecEnv  # noqa: E402


def batch(**options):
    return StableVecEnv(make_vec("Palpation", 3, autoreset_mode=AutoresetMode.SAME_STEP, **options))


def test_the_end_of_an_episode_is_told_as_it_is_asked_for():
    envs = batch(most_steps=2)
    envs.seed(5)
    first = envs.reset()
    assert first.shape == (3, 11)
    stay = np.zeros((3, 4), np.float32)
    _, one, over, infos = envs.step(stay)
    assert not over.any() and all("episode" not in info for info in infos)
    fresh, two, over, infos = envs.step(stay)
    assert over.all()
    for i, info in enumerate(infos):
        assert info["TimeLimit.truncated"] and not info["is_success"]
        assert info["episode"] == {"r": pytest.approx(one[i] + two[i]), "l": 2}
        assert not np.array_equal(info["terminal_observation"], fresh[i]), "the next episode has begun"
    # Seeds are used once.
    envs.seed(5)
    np.testing.assert_array_equal(envs.reset(), first)
    assert not np.array_equal(envs.reset(), first)
    with pytest.raises(ValueError, match="SAME_STEP"):
        StableVecEnv(make_vec("Palpation", 1))


def test_a_policy_learns_in_it():
    envs = batch(most_steps=10)
    policy = PPO("MlpPolicy", envs, n_steps=20, batch_size=30, seed=1, device="cpu")
    policy.learn(120)
    assert policy.num_timesteps >= 120 and len(policy.ep_info_buffer) > 0
