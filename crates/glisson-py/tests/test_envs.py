"""Environments: Gymnasium's own checks, scripted success, the same episodes at any number of threads and environments."""

import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import glisson.envs
from glisson.envs import TASKS, make, make_vec

NAMES = sorted(TASKS)


@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_finds_nothing_to_say(name):
    env = gymnasium.make(f"glisson/{name}-v0")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Numbers of an observation have no bounds: forces have none.
        warnings.filterwarnings("ignore", message=".*Box observation space.*infinity.*")
        check_env(env.unwrapped, skip_render_check=True)
    task = env.unwrapped.task
    assert env.observation_space.shape == (len(task.observation_names),)
    assert env.action_space.shape == (len(task.action_names),)
    vector = gymnasium.make_vec(f"glisson/{name}-v0", num_envs=2)
    assert vector.reset(seed=1)[0].shape == (2, len(task.observation_names))


@pytest.mark.parametrize("name", NAMES)
def test_who_knows_all_reaches_the_goal(name):
    env = make(name)
    # Those of whole livers take seconds.
    for seed in range(2 if name == "LiverResection" else 10):
        env.reset(seed=seed)
        for _ in range(env.task.most_steps):
            _, reward, done, cut_off, info = env.step(env.scripted_action())
            weights = env.task.reward_weights
            assert reward == pytest.approx(sum(weights[term] * info[f"reward_{term}"] for term in weights))
            if done or cut_off:
                break
        assert done and info["is_success"], f"seed {seed}"


def episodes(name, num_envs, threads, n_steps=40):
    envs = make_vec(name, num_envs, threads=threads, most_steps=25)
    seen = [envs.reset(seed=7)[0]]
    random = np.random.default_rng(3)
    actions = random.uniform(-1, 1, (n_steps, 8, envs.single_action_space.shape[0])).astype(np.float32)
    for step in range(n_steps):
        seen.append(np.column_stack([*envs.step(actions[step, :num_envs])[:4]]))
    return seen, envs.batch.worlds.hashes()


@pytest.mark.parametrize("name", NAMES)
def test_episodes_do_not_depend_on_threads_nor_on_the_others(name):
    reference, hashes = episodes(name, 6, 1)
    for num_envs, threads in ((6, 2), (3, 2), (1, 1)):
        others, other_hashes = episodes(name, num_envs, threads)
        assert other_hashes == hashes[: len(other_hashes)]
        for a, b in zip(reference, others):
            np.testing.assert_array_equal(a[:num_envs], b)


def test_one_environment_alone_has_the_episodes_of_one_of_many():
    envs, env = make_vec("TissueRetraction", 2), make("TissueRetraction")
    many, one = envs.reset(seed=[4, 5])[0], env.reset(seed=5)[0]
    np.testing.assert_array_equal(many[1], one)
    for _ in range(5):
        many, one = envs.step(envs.scripted_actions())[0], env.step(env.scripted_action())[0]
        np.testing.assert_array_equal(many[1], one)


def test_next_step_begins_the_next_episode_with_the_step_after_the_last():
    envs = make_vec("TissueRetraction", 2, most_steps=3)
    first, _ = envs.reset(seed=1)
    stay = np.zeros(envs.action_space.shape, np.float32)
    for step in range(1, 4):
        _, _, _, cut_off, _ = envs.step(stay)
        assert cut_off.all() == (step == 3)
    # The action does not count, and nothing is rewarded.
    fresh, rewards, done, cut_off, infos = envs.step(stay + 1)
    assert not rewards.any() and not done.any() and not cut_off.any()
    assert not np.array_equal(fresh, first), "another episode"
    assert not infos["_reward_lift"].any()
    envs.step(stay)
    assert (envs.batch.episodes.steps == 1).all()


def test_same_step_gives_the_last_observation_beside_the_first_of_the_next():
    envs = make_vec("TissueRetraction", 2, most_steps=2, autoreset_mode=AutoresetMode.SAME_STEP)
    envs.reset(seed=1)
    stay = np.zeros(envs.action_space.shape, np.float32)
    envs.step(stay)
    fresh, _, _, cut_off, infos = envs.step(stay)
    assert cut_off.all() and infos["_final_obs"].all()
    assert not np.array_equal(infos["final_obs"][0], fresh[0])
    assert infos["final_info"]["reward_lift"].shape == (2,)
    assert not infos["_reward_lift"].any(), "of the last step it is in final_info alone"
    _, _, _, cut_off, _ = envs.step(stay)
    assert not cut_off.any()


def test_disabled_waits_for_a_reset_of_what_is_over():
    envs = make_vec("TissueRetraction", 3, most_steps=2, autoreset_mode=AutoresetMode.DISABLED)
    stay = np.zeros(envs.action_space.shape, np.float32)
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(stay)
    envs.reset(seed=1)
    envs.step(stay)
    envs.step(stay)
    with pytest.raises(gymnasium.error.ResetNeeded, match="0, 1, 2"):
        envs.step(stay)
    before = envs.batch.observed.copy()
    after, _ = envs.reset(options={"reset_mask": np.array([True, False, True])})
    np.testing.assert_array_equal(after[1], before[1])
    assert not np.array_equal(after[0], before[0])


def test_pictures_of_environments():
    env = make("Palpation", render_mode="rgb_array")
    env.reset(seed=1)
    one = env.render()
    assert one.shape == (240, 320, 3) and one.dtype == np.uint8
    envs = make_vec("Palpation", 2, render_mode="rgb_array")
    envs.reset(seed=[3, 1])
    np.testing.assert_array_equal(envs.render()[1], one)
    with pytest.raises(ValueError, match="rgb_array"):
        make("Palpation", render_mode="human")


def test_bad_input_is_refused_in_words():
    with pytest.raises(ValueError, match="TissueRetraction"):
        make("TissueRetractoin")
    with pytest.raises(ValueError, match="approach"):
        make("TissueRetraction", reward_weights={"aproach": 1.0})
    with pytest.raises(glisson.SceneError):
        make("TissueRetraction", edge_m=-1.0)
    env = make("TissueRetraction")
    env.reset(seed=1)
    with pytest.raises(ValueError, match="finite"):
        env.step(np.full(4, np.nan, np.float32))
    with pytest.raises(ValueError, match="x, y, z, jaws"):
        env.step(np.zeros(3, np.float32))
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.step(np.zeros(4, np.float32))


def resident_bytes():
    with open("/proc/self/statm") as statm:
        return int(statm.read().split()[1]) * 4096


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_many_resets_leave_nothing_behind():
    env = make("TissueRetraction", edge_m=0.008)
    used = []
    for _ in range(3):
        for seed in range(150):
            env.reset(seed=seed)
        used.append(resident_bytes())
    assert used[2] - used[1] < 150 * 5_000, f"bytes: {used}"


def test_a_generator_of_ones_own_and_the_seed_that_was_drawn_give_the_episode_again():
    env = make("TissueRetraction")
    first, _ = env.reset()
    again, _ = env.reset(seed=env.np_random_seed)
    np.testing.assert_array_equal(first, again)
    other, _ = env.reset()
    assert not np.array_equal(first, other)


def test_only_what_begins_is_seeded_and_remembers_anew():
    class Counts(glisson.envs.Palpation):
        def remember(self, episodes, seen, fresh):
            super().remember(episodes, seen, fresh)
            count = episodes.memory.setdefault("count", np.zeros(len(fresh)))
            count += 1
            count[fresh] = 0

    envs = glisson.envs.TissueVectorEnv(Counts(most_steps=4), 2, autoreset_mode=AutoresetMode.DISABLED)
    envs.reset(seed=1)
    stay = np.zeros(envs.action_space.shape, np.float32)
    for _ in range(3):
        envs.step(stay)
    np.testing.assert_array_equal(envs.batch.episodes.memory["count"], [3, 3])
    kept = envs.batch.randoms[1]
    envs.reset(seed=9, options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(envs.batch.episodes.memory["count"], [0, 3])
    assert envs.batch.randoms[1] is kept


def test_an_episode_that_is_over_or_not_begun_says_so():
    env = make("Palpation", most_steps=1)
    stay = np.zeros(4, np.float32)
    for act in (lambda: env.step(stay), env.scripted_action):
        with pytest.raises(gymnasium.error.ResetNeeded):
            act()
    env.reset(seed=1)
    assert env.step(stay)[3]
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(stay)
