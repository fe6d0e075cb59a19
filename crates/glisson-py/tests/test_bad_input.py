"""Whatever a caller does: an exception, and never the end of the interpreter. Memory is watched by the debug allocators of Python and C."""

import os
import random
import subprocess
import sys
import threading

import numpy as np

import glisson
from conftest import BLOCK

#: Calls; some 10 s.
N_CALLS = 1500


def values(rng):
    """Something to hand in, mostly wrong."""
    kinds = [
        lambda: None,
        lambda: rng.choice([0, 1, -1, 2**31, 2**63, -(2**63), 10**30]),
        lambda: rng.choice([float("nan"), float("inf"), -0.0, 1e300]),
        lambda: rng.choice(["", "x" * 1000, "\0", "\ud800", "outside", "nowhere.toml"]),
        lambda: rng.choice([b"", object(), int, [], {}, [[]], [1, [2]], {"a": object()}, ()]),
        lambda: np.full((rng.randrange(3), rng.randrange(12)), rng.choice([np.nan, 0.0, 1e9])),
        lambda: np.zeros((1, 9)),
        lambda: np.arange(9, dtype=rng.choice(["int8", "uint64", "complex128", "O", "U3"]))[:: rng.choice([1, -1])],
        lambda: np.zeros((0, 3)),
        lambda: np.lib.stride_tricks.as_strided(np.zeros(3), (1, 9), (0, 0)),
        lambda: np.ones((4, 4, 4), dtype=rng.choice(["uint8", "float32", "bool"])),
    ]
    return rng.choice(kinds)()


def objects(rng):
    """Something to call, right until it is used."""
    scene = glisson.scene_from_dict(BLOCK)
    world, worlds = glisson.World(scene), glisson.Worlds([scene, scene], threads=2)
    image = glisson.Image(np.zeros((4, 5, 6)), [1e-3] * 3)
    labels = glisson.Labels(np.ones((4, 4, 4), int), [1e-3] * 3)
    mesh = glisson.Mesh(np.eye(4, 3), [[0, 1, 2, 3]])
    if rng.random() < 0.2:
        world.close()
    return [glisson, scene, world, worlds, image, labels, mesh, mesh.surface(), glisson.Scene, glisson.Image, glisson.Labels, glisson.Mesh]


#: They wait, write files, start programs, or take minutes.
PASSED_OVER = {"run_program", "validate", "save", "replay_session", "Series", "World", "Worlds", "json", "os", "Any", "annotations", "Mapping"}


def abuse(seed):
    rng = random.Random(seed)
    called = raised = 0
    for n in range(N_CALLS):
        if n % 100 == 0:
            targets = objects(rng)
        target = rng.choice(targets)
        names = [name for name in dir(target) if not name.startswith("_") and name not in PASSED_OVER]
        try:
            member = getattr(target, rng.choice(names))
            if callable(member):
                called += 1
                arguments = [values(rng) for _ in range(rng.randrange(4))]
                # Not so many steps that it takes for ever.
                member(*[3 if isinstance(a, int) and not isinstance(a, bool) and abs(a) > 2 else a for a in arguments])
        except Exception:
            raised += 1
    assert called > N_CALLS / 3 and raised > 100, (called, raised)


def test_calls_with_anything_raise_under_debug_allocators():
    watched = {"PYTHONMALLOC": "debug", "PYTHONDEVMODE": "1", "MALLOC_CHECK_": "3", "MALLOC_PERTURB_": "165", "GLIBC_TUNABLES": "glibc.malloc.check=3"}
    here = os.path.dirname(__file__)
    code = f"import sys; sys.path.insert(0, {here!r}); import test_bad_input; test_bad_input.abuse(int(sys.argv[1]))"
    for seed in (1, 2):
        done = subprocess.run([sys.executable, "-c", code, str(seed)], env={**os.environ, **watched}, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, (seed, done.returncode, done.stderr[-3000:])


def test_threads_that_share_everything_end_in_exceptions():
    scene = glisson.scene_from_dict(BLOCK)
    world, worlds = glisson.World(scene), glisson.Worlds([scene] * 3, threads=2)
    saved, wrong = world.save(), []

    def work(seed):
        rng = random.Random(seed)
        acts = [
            lambda: world.step(3, world.poses),
            lambda: world.positions_m,
            world.hash,
            lambda: world.restore(saved),
            lambda: world.picture(32, 32),
            lambda: worlds.step(worlds.poses, 2),
            lambda: worlds.restart([rng.randrange(3)]),
            lambda: worlds.pictures(16, 16),
            world.reset,
        ]
        for _ in range(150):
            try:
                rng.choice(acts)()
            except glisson.SimulationError:
                pass
            except BaseException as error:  # noqa: BLE001 - told below
                wrong.append(repr(error))

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
        assert not thread.is_alive()
    assert wrong == []
    # One thread alone goes on.
    world.restore(saved)
    world.step(1)
