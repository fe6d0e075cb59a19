"""What environments observe by choice, and environments of several agents."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import glisson
from glisson.envs import OBSERVATIONS, make, make_parallel, make_vec

ALL = tuple(OBSERVATIONS)


@pytest.mark.filterwarnings("ignore:.*Box observation space.*")
def test_all_that_can_be_observed_is_in_its_space():
    env = make("GraspLiftTouch", observe=ALL, observe_options={"picture_size": (40, 30), "n_points": 50})
    check_env(env, skip_render_check=True)
    seen, _ = env.reset(seed=1)
    assert set(seen) == set(ALL) and env.observation_space.contains(seen)
    shapes = {name: values.shape for name, values in seen.items()}
    assert shapes == {
        "state": (21,),
        "wrench": (2, 6),
        "strain": (2,),
        "stress": (2,),
        "damage": (4,),
        "cloud": (50, 3),
        "rgb": (30, 40, 3),
        "depth": (30, 40),
        "segmentation": (30, 40),
    }


def test_many_observe_the_same_as_one_and_the_last_of_an_episode_is_kept():
    chosen = {"observe": ("state", "depth", "cloud"), "observe_options": {"picture_size": (32, 32)}, "most_steps": 2}
    envs = make_vec("TissueRetraction", 2, autoreset_mode=AutoresetMode.SAME_STEP, **chosen)
    env = make("TissueRetraction", **chosen)
    many, one = envs.reset(seed=[4, 5])[0], env.reset(seed=5)[0]
    assert envs.observation_space.contains(many)
    for step in range(2):
        stay = np.zeros(envs.action_space.shape, np.float32)
        many, _, _, _, infos = envs.step(stay)
        one = env.step(stay[1])[0]
        last = infos["final_obs"][1] if step == 1 else {name: values[1] for name, values in many.items()}
        for name, values in one.items():
            np.testing.assert_array_equal(last[name], values)


def test_stress_wrench_and_damage_grow_where_tissue_is_lifted():
    env = make("TissueRetraction", observe=("wrench", "stress", "strain", "damage"))
    first, _ = env.reset(seed=3)
    assert first["stress"].max() < 1e-3 and first["damage"].max() < 1e-6
    for _ in range(env.task.most_steps):
        seen, _, done, _, _ = env.step(env.scripted_action())
        if done:
            break
    assert np.linalg.norm(seen["wrench"][0, :3]) > 0.01 and np.linalg.norm(seen["wrench"][0, 3:]) > 0.0
    assert seen["stress"].min() > 10.0 and seen["strain"].min() > 1e-3
    assert seen["damage"][0] > seen["strain"].max() / 3 and seen["damage"][2] == 0.0


def test_depth_and_segmentation_are_of_what_the_picture_shows():
    env = make("PrecisionCutting", observe=("rgb", "depth", "segmentation", "cloud"), observe_options={"picture_size": (96, 96)})
    seen, _ = env.reset(seed=0)
    nothing = seen["segmentation"] == 0
    np.testing.assert_array_equal(nothing, seen["depth"] == 0.0)
    assert set(np.unique(seen["segmentation"])) == {0, 1, 4}, "nothing, the scalpel, the plate"
    # The ground is dark, the plate is not, but for pixels at its edges.
    assert np.median(seen["rgb"][nothing].max(axis=1)) < 60 < np.median(seen["rgb"][seen["segmentation"] == 4].max(axis=1))
    # The plate is not deeper than its size says.
    depth_m = seen["depth"][seen["segmentation"] == 4]
    assert 0.01 < np.ptp(depth_m) < 0.08
    # All points are of the plate's surface at rest.
    assert (np.abs(seen["cloud"]) < np.array([0.0301, 0.0021, 0.0201])).all()
    # A piece that is cut off and taken away.
    env, done = make("TaskFile", task="cut_off", observe=("segmentation",)), False
    env.reset(seed=0)
    while not done:
        seen, _, done, _, _ = env.step(env.scripted_action())
    assert {1, 3, 4} <= set(np.unique(seen["segmentation"])), "faces of the cut"
    two, _ = make("TissueDissection", observe=("segmentation",)).reset(seed=0)
    assert {2, 4, 5} <= set(np.unique(two["segmentation"])), "strands, bed and flap"


def test_an_endoscope_sees_another_picture_than_who_looks_from_outside():
    chosen = {"task": "cut_off", "observe": ("depth",)}
    outside, _ = make("TaskFile", **chosen).reset(seed=1)
    inside, _ = make("TaskFile", observe_options={"view": "endoscope"}, **chosen).reset(seed=1)
    assert not np.array_equal(outside["depth"], inside["depth"])
    with pytest.raises(glisson.SimulationError, match="no endoscope"):
        make("Palpation", observe=("depth",), observe_options={"view": "endoscope"}).reset(seed=1)


def test_choices_that_are_none_are_refused_in_words():
    with pytest.raises(ValueError, match="segmentation"):
        make("Palpation", observe=("state", "segmentatoin"))
    with pytest.raises(ValueError, match="choose"):
        make("Palpation", observe=())
    with pytest.raises(ValueError, match="picture_size"):
        make("Palpation", observe=("rgb",), observe_options={"picture_size": (0, 3)})


TASKS_WITH_OWN_WAYS = ("clip_and_cut", "ligating_loop", "camera_navigation")


@pytest.mark.parametrize("task", TASKS_WITH_OWN_WAYS)
def test_a_task_file_is_an_environment_that_its_demonstration_solves(task):
    env = make("TaskFile", task=task)
    env.reset(seed=2)
    total = 0.0
    for _ in range(env.task.most_steps):
        _, _, done, cut_off, info = env.step(env.scripted_action())
        total += info["reward_progress"]
        if done or cut_off:
            break
    assert done and info["is_success"]
    # All stages, from nothing.
    assert total == pytest.approx(1.0, abs=0.02)


def test_task_files_of_ones_own_and_such_that_cannot_be_environments(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text(glisson.Scene.task("cut_off").text)
    a, b = make("TaskFile", task=own), make("TaskFile", task="cut_off")
    np.testing.assert_array_equal(a.reset(seed=1)[0], b.reset(seed=1)[0])
    with pytest.raises(ValueError, match="levels and patients"):
        make("TaskFile", task=own, level="hard")
    with pytest.raises(glisson.SceneError, match="no_such"):
        make("TaskFile", task="no_such_task")
    lines = [line for line in own.read_text().splitlines() if not line.startswith(("time =", "tip =", "jaw =", "shaft ="))]
    own.write_text("\n".join(line for line in lines if "[[tool.path]]" not in line))
    with pytest.raises(ValueError, match="no instrument has a path"):
        make("TaskFile", task=own)


def test_hands_are_agents_that_share_what_they_see_and_gain():
    test = pytest.importorskip("pettingzoo.test")
    test.parallel_api_test(make_parallel("GraspLiftTouch", most_steps=30), num_cycles=100)
    env, alone = make_parallel("GraspLiftTouch"), make("GraspLiftTouch")
    seen, _ = env.reset(seed=6)
    np.testing.assert_array_equal(seen["probe"], alone.reset(seed=6)[0])
    assert env.possible_agents == ["grasper", "probe"]
    assert env.action_space("grasper").shape == (4,) and env.action_space("probe").shape == (3,)
    while env.agents:
        _, rewards, done, _, infos = env.step(env.scripted_actions())
        reward = alone.step(alone.scripted_action())[1]
        assert rewards == {"grasper": reward, "probe": reward}
    assert all(done.values()) and infos["probe"]["is_success"]
    # Of a task file each instrument that is led is one.
    assert make_parallel("TaskFile", task="cut_off").possible_agents == ["grasper", "scissors"]


def test_one_agent_where_there_is_one_hand():
    pytest.importorskip("pettingzoo")
    env = make_parallel("Palpation")
    env.reset(seed=1)
    assert env.agents == ["surgeon"] and env.action_space("surgeon") == gymnasium.spaces.Box(-1.0, 1.0, (4,), np.float32)
