"""What the tests share."""

import pytest

import glisson

#: A soft block that a probe can press; 480 tetrahedra.
BLOCK = {
    "glisson_scene": 1,
    "name": "block",
    "simulation": {"time_step": "2 ms"},
    "organ": {
        "box": {"min": ["-20 mm", "-10 mm", "-20 mm"], "max": ["20 mm", "10 mm", "20 mm"]},
        "edge": "7 mm",
        "tissue": "liver",
        "model": "implicit",
        "law": "stable_neo_hooke",
        "damping": "20 1/s",
        "fixed": [{"furthest": {"direction": [0, 1, 0], "fraction": 0.2}}],
    },
    "tool": [
        {
            "name": "probe",
            "tip_radius": "3 mm",
            "home_tip": ["0 mm", "-20 mm", "0 mm"],
            "home_shaft": [0, -1, 0],
        },
    ],
}


@pytest.fixture
def scene():
    return glisson.scene_from_dict(BLOCK)


def pressed(world, depth_m=0.005):
    """Poses of the probe pressed into the block from the front."""
    poses = world.poses.copy()
    poses[0, :3] = [0.0, -0.013 + depth_m, 0.0]
    return poses
