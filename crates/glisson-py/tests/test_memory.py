"""What is made anew is given back."""

import pathlib
import sys

import pytest

import glisson

sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "benches"))

memory = pytest.importorskip("memory")
pytestmark = pytest.mark.skipif(not pathlib.Path("/proc/self/statm").exists(), reason="memory is read from /proc")


def test_resets_keep_no_memory():
    readings = memory.memory_over_resets("TissueRetraction", 1500, steps=1)
    # A world of 480 tetrahedra has more than 1 MB.
    assert memory.growth_bytes(readings) < 2e6, readings


def test_worlds_give_their_memory_back(scene):
    sizes = []
    for _ in range(60):
        worlds = [glisson.World(scene) for _ in range(4)]
        saved = [world.save() for world in worlds]
        for world, moment in zip(worlds, saved):
            world.step(2)
            world.remove([0])
            world.restore(moment)
        del worlds, saved, world, moment
        sizes.append(memory.resident_bytes())
    assert sizes[-1] - sizes[20] < 4e6, sizes
