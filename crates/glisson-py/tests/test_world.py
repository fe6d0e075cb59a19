"""Scenes and worlds: bits, arrays, edits, and what goes wrong."""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import glisson
from conftest import BLOCK, pressed


def test_scenes_come_from_files_texts_dictionaries_and_tasks(tmp_path, scene):
    file = tmp_path / "block.toml"
    file.write_text(scene.text)
    for other in (glisson.Scene.load(file), glisson.Scene.parse(scene.text), pickle.loads(pickle.dumps(scene))):
        assert (other.name, other.tool_names, other.time_step_s) == ("block", ["probe"], 0.002)
    numpy_scene = {**BLOCK, "tool": [{**BLOCK["tool"][0], "home_shaft": np.array([0.0, -1.0, 0.0])}]}
    assert glisson.scene_from_dict(numpy_scene).tool_names == ["probe"]
    assert "palpation" in glisson.task_names()
    assert glisson.Scene.task("palpation", level="hard", patient=4).name.startswith("Palpation")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: glisson.Scene.load("nowhere.toml"), "nowhere.toml"),
        (lambda: glisson.Scene.parse("glisson_scene = 1\norgn = 3"), "orgn"),
        (lambda: glisson.scene_from_dict({"glisson_scene": 1, "organ": None}), "scene"),
        (lambda: glisson.Scene.task("palpatoin"), "palpation"),
        (lambda: glisson.Scene.task("palpation", patient=5), "5"),
    ],
)
def test_a_scene_that_cannot_be_read_says_why(make, words):
    with pytest.raises(glisson.SceneError, match=words):
        make()


def test_a_dictionary_holds_what_a_scene_file_can(scene):
    with pytest.raises(TypeError, match="object"):
        glisson.scene_from_dict({"glisson_scene": object()})
    with pytest.raises(ValueError):
        glisson.scene_from_dict({"glisson_scene": float("nan")})


def test_pressing_gives_a_force_and_moves_the_tissue(scene):
    world = glisson.World(scene)
    assert world.positions_m.shape == world.velocities_m_per_s.shape == world.rest_positions_m.shape
    assert world.surface.max() < len(world.positions_m) and world.tetrahedra.shape[1] == 4
    world.step(100, pressed(world))
    assert world.steps == 100 and world.time_s == pytest.approx(0.2)
    assert world.forces_n[0, 1] < -0.05, "out of the block, towards the front"
    moved = np.linalg.norm(world.positions_m - world.rest_positions_m, axis=1)
    assert 0.002 < moved.max() < 0.006
    places, normals, forces, tools = world.contacts()
    assert len(places) == len(normals) == len(forces) == len(tools) > 0
    np.testing.assert_allclose(forces.sum(axis=0), world.forces_n[0], atol=1e-9)


def test_the_same_poses_give_the_same_bits_after_saving_and_at_any_number_of_threads(scene):
    hashes = []
    for threads in (1, 2):
        world = glisson.World(scene, threads=threads)
        poses = pressed(world)
        world.step(30, poses)
        saved = world.save()
        middle = world.hash()
        poses[0, 0] += 0.004
        world.step(30, poses)
        end = world.hash()
        # Back into the middle of the contact, twice; the other time from another state.
        for _ in range(2):
            world.restore(saved)
            assert world.hash() == middle
            world.step(30, poses)
            assert world.hash() == end
        other = glisson.World(scene)
        other.restore(saved)
        other.step(30, poses)
        hashes += [end, other.hash()]
    assert len(set(hashes)) == 1


def test_worlds_are_each_as_one_alone_at_any_number_of_threads(scene):
    depths_m = [0.002, 0.004, 0.006]
    alone = []
    for depth_m in depths_m:
        world = glisson.World(scene)
        world.step(40, pressed(world, depth_m))
        alone.append(world.hash())
    for threads in (1, 2, 3):
        worlds = glisson.Worlds([scene] * 3, threads=threads)
        assert len(worlds) == 3 and worlds.threads == threads
        poses = worlds.poses.copy()
        start = worlds.hashes()
        for i, depth_m in enumerate(depths_m):
            poses[i, 0, :3] = [0.0, -0.013 + depth_m, 0.0]
        worlds.step(poses, 40)
        assert worlds.hashes() == alone
        assert (np.diff(np.linalg.norm(worlds.forces_n[:, 0], axis=1)) > 0).all()
        # Some begin anew, the others stay as they are.
        worlds.restart([0, 2])
        assert worlds.hashes() == [start[0], alone[1], start[2]]
        worlds.step(poses[[2, 0]], 40, [2, 0])
        assert worlds.hashes() == alone


def test_tracked_points_are_those_of_the_surface(scene):
    worlds = glisson.Worlds([scene] * 2)
    worlds.track(np.array([[0.0, -0.010, 0.0]]))
    before_m = worlds.tracked_m
    poses = worlds.poses.copy()
    poses[1, 0, :3] = [0.0, -0.008, 0.0]
    worlds.step(poses, 60)
    moved_m = worlds.tracked_m - before_m
    assert np.abs(moved_m[0]).max() == 0 and 0.002 < moved_m[1, 0, 1] < 0.006


def test_arrays_are_copies_that_nobody_writes_to(scene):
    world = glisson.World(scene)
    before = world.positions_m
    kept = before.copy()
    contacts = world.contacts()
    for array in (before, world.surface, world.poses, world.n_held, *contacts, world.picture(8, 8), glisson.Worlds([scene]).poses):
        assert not array.flags.writeable
    with pytest.raises(ValueError):
        before[0, 0] = 1.0
    world.step(30, pressed(world))
    np.testing.assert_array_equal(before, kept)
    assert not np.array_equal(world.positions_m, kept)
    world.close()
    np.testing.assert_array_equal(before, kept)


def test_a_tip_cuts_what_it_touches_makes_the_mesh_finer_and_the_table_is_tilted(scene):
    world = glisson.World(scene)
    world.cut(0)
    assert any("nothing was cut" in notice for notice in world.notices), "it touches nothing yet"
    world.step(60, pressed(world))
    n, sag = len(world.tetrahedra), world.positions_m.copy()
    world.refine(0)
    assert len(world.tetrahedra) > n
    n = len(world.tetrahedra)
    world.cut(0)
    assert len(world.tetrahedra) < n and world.removed_volume_m3 > 0
    tilted = glisson.World(scene)
    tilted.set_gravity([50.0, 0.0, 0.0])
    tilted.step(100)
    assert (tilted.positions_m - tilted.rest_positions_m)[:, 0].max() > 1e-4 and sag.shape[1] == 3
    with pytest.raises(ValueError, match="not finite"):
        tilted.set_gravity([0.0, float("nan"), 0.0])
    for edit in (world.cut, world.refine, world.clip):
        with pytest.raises(glisson.SimulationError, match="no instrument 7"):
            edit(7)


def test_cuts_change_the_topology_and_are_taken_back(scene):
    world = glisson.World(scene)
    saved, start = world.save(), world.hash()
    version, n, volume_m3 = world.topology_version, len(world.tetrahedra), world.removed_volume_m3
    world.remove([0, 5])
    assert world.topology_version > version and len(world.tetrahedra) == n - 2
    assert world.removed_volume_m3 > volume_m3
    world.step(20, pressed(world))
    cut = world.hash()
    world.restore(saved)
    assert world.hash() == start and len(world.tetrahedra) == n
    world.remove([0, 5])
    world.step(20, pressed(world))
    assert world.hash() == cut
    world.undo()
    assert len(world.tetrahedra) == n
    with pytest.raises(glisson.SimulationError, match="no tetrahedron 100000"):
        world.remove([100_000])


def test_a_recorded_session_replays_to_the_same_bits(tmp_path, scene):
    session = tmp_path / "session.jsonl"
    with glisson.World(scene, record=session) as world:
        world.step(40, pressed(world))
        with pytest.raises(glisson.SimulationError, match="recorded"):
            world.save()
        end = world.hash()
    assert session.stat().st_size > 1000
    program = os.environ.get("GLISSON_PROGRAM")
    if program is None:
        pytest.skip("GLISSON_PROGRAM is not set (the program glisson)")
    replayed = subprocess.run([program, "replay", session], capture_output=True, text=True, check=True)
    assert end in replayed.stdout + replayed.stderr


def test_a_task_tells_how_far_it_is():
    world = glisson.World(glisson.Scene.task("camera_navigation"))
    assert world.task["n_done"] == 0 and world.task["outcome"] is None
    assert {"metrics", "stages"} <= set(world.result)
    assert glisson.World(glisson.scene_from_dict(BLOCK)).task is None


def test_poses_of_another_shape_and_numbers_that_are_none_are_refused(scene):
    world = glisson.World(scene)
    start = world.hash()
    good = world.poses
    bad = {
        "shape": good[:, :8],
        "expected": np.zeros((2, 9)),
        "finite": np.full((1, 9), np.nan),
        "direction": np.zeros((1, 9)),
    }
    for words, poses in bad.items():
        with pytest.raises(ValueError, match=words):
            world.step(1, poses)
    with pytest.raises(TypeError):
        world.step(1, "here")
    with pytest.raises(OverflowError):
        world.step(-1)
    with pytest.raises(ValueError, match="threads is 0"):
        glisson.World(scene, threads=0)
    worlds = glisson.Worlds([scene])
    with pytest.raises(ValueError, match="no world 1"):
        worlds.restart([1])
    with pytest.raises(ValueError, match="twice"):
        worlds.restart([0, 0])
    with pytest.raises(ValueError, match="one scene"):
        glisson.Worlds([])
    assert world.hash() == start, "nothing was done"


def test_a_closed_world_says_so(scene):
    world = glisson.World(scene)
    hash_at_end = world.hash()
    assert world.close() == hash_at_end and world.close() is None
    for use in (world.step, world.hash, world.save, lambda: world.positions_m):
        with pytest.raises(glisson.SimulationError, match="closed"):
            use()
    assert "closed" in repr(world)


def test_worlds_cannot_be_pickled(scene):
    for it in (glisson.World(scene), glisson.Worlds([scene])):
        with pytest.raises(TypeError, match="pickle"):
            pickle.dumps(it)


def refusals_while(step, look):
    """Steps in another thread, tried until it is let, and looks meanwhile; how often looking was refused."""
    begun = threading.Event()

    def step_when_let():
        begun.set()
        while True:
            try:
                return step()
            except glisson.SimulationError as error:
                assert "another thread" in str(error)

    thread = threading.Thread(target=step_when_let)
    thread.start()
    begun.wait()
    n_refused = 0
    while thread.is_alive():
        try:
            look()
        except glisson.SimulationError as error:
            assert "another thread" in str(error)
            n_refused += 1
    thread.join()
    return n_refused


def test_two_threads_cannot_use_one_world_and_neither_waits_for_ever(scene):
    world = glisson.World(scene)
    poses = pressed(world)
    # The lock of Python is free meanwhile: this thread goes on, and is refused until the other one is done.
    assert refusals_while(lambda: world.step(400, poses), lambda: world.steps) > 0
    assert world.steps == 400


def test_pictures_show_the_world_as_it_is(scene):
    world = glisson.World(scene)
    before = world.picture(160, 120)
    assert before.shape == (120, 160, 3) and before.dtype == np.uint8
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 100, "not one colour"
    np.testing.assert_array_equal(world.picture(160, 120), before)
    world.step(60, pressed(world))
    assert not np.array_equal(world.picture(160, 120), before)
    worlds = glisson.Worlds([scene] * 2)
    pictures = worlds.pictures(160, 120)
    assert pictures.shape == (2, 120, 160, 3)
    np.testing.assert_array_equal(pictures[1], before)
    assert worlds.pictures(16, 16, worlds=[1]).shape == (1, 16, 16, 3)
    # Another size does not change from where it is seen.
    now = world.picture(160, 120)
    world.picture(80, 60)
    np.testing.assert_array_equal(world.picture(160, 120), now)
    with pytest.raises(ValueError, match="endoscope"):
        world.picture(view="inside")
    with pytest.raises(glisson.SimulationError, match="no endoscope"):
        world.picture(view="endoscope")
    with pytest.raises(glisson.SimulationError, match="0 x 10"):
        world.picture(0, 10)


def test_a_picture_after_coming_back_is_of_what_is_there_then(scene):
    world, other = glisson.World(scene), glisson.World(scene)
    for it in (world, other):
        it.picture(64, 48)
    saved = world.save()
    world.remove([0, 5])
    world.picture(64, 48)
    world.restore(saved)
    # As many versions of the surface, and another surface.
    for it in (world, other):
        it.remove(list(range(40)))
    np.testing.assert_array_equal(world.picture(64, 48), other.picture(64, 48))


def test_a_moment_comes_back_in_a_world_of_its_scene_alone(scene):
    saved = glisson.World(scene).save()
    glisson.World(glisson.Scene.parse(scene.text)).restore(saved)
    with pytest.raises(glisson.SimulationError, match="another scene"):
        glisson.World(glisson.Scene.task("camera_navigation")).restore(saved)


def test_who_uses_worlds_that_step_is_told(scene):
    worlds = glisson.Worlds([scene] * 2, threads=1)
    poses = worlds.poses.copy()
    poses[:, 0, :3] = [0.0, -0.008, 0.0]

    def look():
        times_s = worlds.times_s
        assert times_s[0] == times_s[1], "not torn"

    assert refusals_while(lambda: worlds.step(poses, 400), look) > 0
    assert worlds.times_s == pytest.approx([0.8, 0.8])


def test_what_is_inside_is_told_and_a_session_replays(tmp_path, scene):
    session = tmp_path / "session.jsonl"
    with glisson.World(scene, record=session) as world:
        assert world.strain.shape == world.stress_pa.shape == (len(world.positions_m),)
        assert np.abs(world.strain).max() < 1e-12 and sum(world.energies_j) < 1e-15
        world.step(100, pressed(world))
        assert 0.05 < world.strain.max() < 2.0 and 100.0 < world.stress_pa.max() < 1e5
        elastic_j, kinetic_j = world.energies_j
        assert 1e-5 < elastic_j < 1e-2 and 0.0 < kinetic_j < elastic_j
        recorded = world.close()
    assert glisson.replay_session(session) == recorded
    broken = tmp_path / "broken.jsonl"
    broken.write_text(session.read_text()[:200])
    with pytest.raises(glisson.SimulationError, match="broken.jsonl"):
        glisson.replay_session(broken)


def test_the_program_is_in_the_package(tmp_path, capfd):
    python = [sys.executable, "-m", "glisson"]
    said = subprocess.run([*python, "task", "list"], capture_output=True, text=True, check=True).stdout
    assert all(task in said for task in glisson.task_names())
    help_text = subprocess.run([*python, "--help"], capture_output=True, text=True, check=True).stdout
    assert "Usage: glisson" in help_text
    wrong = subprocess.run([*python, "meshh"], capture_output=True, text=True)
    assert wrong.returncode == 2 and "mesh" in wrong.stderr
    # Within a program of one's own: from a picture of a body to a mesh.
    patient, mesh = tmp_path / "patient", tmp_path / "liver.msh"
    assert glisson.run_program(["phantom", "--voxel-mm", "8", "--out", patient]) == 0
    assert glisson.run_program(["mesh", tmp_path / "none.stl", "-o", mesh]) == 1
    assert "none.stl" in capfd.readouterr().err and any(patient.iterdir()) and not mesh.exists()


def test_the_program_ends_where_nobody_reads_and_at_ctrl_c():
    if not sys.platform.startswith("linux"):
        pytest.skip("signals as on Linux")
    command = f"'{sys.executable}' -m glisson task list | head -n 1; echo ${{PIPESTATUS[0]}}"
    said = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert said.stdout.splitlines()[-1] == "0" and said.stderr == ""
    started = subprocess.Popen([sys.executable, "-m", "glisson", "validate", "tasks"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    time.sleep(1.5)
    started.send_signal(signal.SIGINT)
    assert started.wait(20) == -signal.SIGINT


def test_strain_after_coming_back_is_that_of_what_is_there_now(scene):
    def strained(world, removed):
        world.remove([removed])
        world.step(5, pressed(world))
        return world.strain

    with glisson.World(scene) as world, glisson.World(scene) as other:
        saved = world.save()
        first = strained(world, 3)
        world.restore(saved)
        second = strained(world, 7)
        np.testing.assert_array_equal(second, strained(other, 7))
        assert not np.array_equal(first, second)
