"""Two hands: a grasper lifts the free edge of a flap, and a probe touches what lies below it."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glisson import Scene, scene_from_dict
from glisson.envs.task import FORCE_THRESHOLD_N, EpisodeTask, Episodes, Floats, Seen, millimetres
from glisson.envs.tissue_retraction import EDGE_M, JAW_STRIDE, STRIDE_M, WITHIN_M, TissueRetraction

#: The edge has to be lifted by so much before the place below counts as touched [m].
LIFTED_M = 0.012
#: The tip of the probe has to come so near to the place [m].
TOUCHED_M = 0.004
PROBE_RADIUS_M = 0.0025
#: How far each tip may go from the middle of the workspace [m].
LOWEST_M = np.array([[-0.020, -0.040, 0.0], [-0.020, -0.010, 0.0]])
HIGHEST_M = np.array([[0.020, 0.010, 0.060], [0.020, 0.030, 0.070]])
#: The probe comes from behind, from the tip towards the handle.
PROBE_SHAFT = np.array([0.0, 0.6, 1.0]) / np.hypot(0.6, 1.0)


class GraspLiftTouch(EpisodeTask):
    """Take the flap's free edge, lift it, and touch the place behind it with the probe while it is held.

    ``edge_m``: length of the mesh's edges; 5 mm makes 480 tetrahedra. The action moves the grasper's tip (x, y, z) and its jaws, and
    the probe's tip (x, y, z): two hands.
    """

    hands: int = 2
    action_names: tuple[str, ...] = ("grasper_x", "grasper_y", "grasper_z", "jaws", "probe_x", "probe_y", "probe_z")
    observation_names: tuple[str, ...] = (
        *(f"grasper_{axis}_m" for axis in "xyz"),
        "jaws",
        "is_held",
        *(f"to_edge_{axis}_m" for axis in "xyz"),
        "lifted_m",
        *(f"probe_{axis}_m" for axis in "xyz"),
        *(f"to_place_{axis}_m" for axis in "xyz"),
        *(f"grasper_force_{axis}_n" for axis in "xyz"),
        *(f"probe_force_{axis}_n" for axis in "xyz"),
    )
    default_weights: ClassVar[dict[str, float]] = {
        "approach": -5.0,
        "lift": -10.0,
        "held": 0.2,
        "touch": -5.0,
        "force": -0.1,
        "success": 10.0,
    }

    def __init__(self, *, edge_m: float = 0.005, **options: Any) -> None:
        super().__init__(**options)
        self.edge_m = edge_m
        # What the grasper does is what it does there.
        self._retraction = TissueRetraction(edge_m=edge_m)

    def agents(self) -> dict[str, list[int]]:
        return {"grasper": [0, 1, 2, 3], "probe": [4, 5, 6]}

    def scenes(self) -> list[Scene]:
        scene = self._retraction.scene()
        scene["name"] = "Grasp, lift and touch"
        scene["tool"].append(
            {
                "name": "probe",
                "kind": "probe",
                "tip_radius": millimetres(PROBE_RADIUS_M),
                "friction": 0.3,
                "home_tip": ["0 mm", "25 mm", "60 mm"],
                "home_shaft": PROBE_SHAFT.tolist(),
            }
        )
        return [scene_from_dict(scene)]

    def tracked_at_rest_m(self) -> Floats:
        return self._retraction.tracked_at_rest_m()

    def begin(self, random: np.random.Generator, variant: int) -> tuple[Floats, dict[str, Floats]]:
        grasper, _ = self._retraction.begin(random, variant)
        probe = np.zeros(9)
        probe[:3] = random.uniform([-0.015, 0.015, 0.045], [0.015, 0.028, 0.065])
        probe[3:6] = PROBE_SHAFT
        # Behind the flap, where its edge was.
        place_m = EDGE_M + random.uniform([-0.006, 0.0, -0.004], [0.006, 0.006, 0.006])
        return np.stack([grasper, probe]), {"place_m": place_m}

    def move(self, episodes: Episodes, actions: Floats) -> Floats:
        hands = episodes.hands.copy()
        ways = np.stack([actions[:, 0:3], actions[:, 4:7]], axis=1)
        hands[:, :, :3] = np.clip(hands[:, :, :3] + STRIDE_M * ways, LOWEST_M, HIGHEST_M)
        hands[:, 0, 7] = np.clip(hands[:, 0, 7] + JAW_STRIDE * actions[:, 3], 0.0, 1.0)
        return hands

    def _lifted_m(self, seen: Seen) -> Floats:
        """How far the edge has gone to the front [m]."""
        lifted_m: Floats = EDGE_M[1] - self._retraction.edge_m_of(seen)[:, 1]
        return lifted_m

    def observe(self, episodes: Episodes, seen: Seen) -> Floats:
        grasper_m, probe_m = seen.poses[:, 0, :3], seen.poses[:, 1, :3]
        held = (seen.n_held[:, 0] > 0).astype(np.float64)
        return np.column_stack(
            [
                grasper_m,
                seen.poses[:, 0, 7],
                held,
                self._retraction.edge_m_of(seen) - grasper_m,
                self._lifted_m(seen),
                probe_m,
                episodes.goals["place_m"] - probe_m,
                seen.forces_n[:, 0],
                seen.forces_n[:, 1],
            ]
        )

    def terms(self, episodes: Episodes, seen: Seen, actions: Floats) -> tuple[dict[str, Floats], NDArray[np.bool_], NDArray[np.bool_]]:
        held, lifted_m = seen.n_held[:, 0] > 0, self._lifted_m(seen)
        is_lifted = held & (lifted_m > LIFTED_M)
        to_place_m = np.linalg.norm(episodes.goals["place_m"] - seen.poses[:, 1, :3], axis=1)
        done = is_lifted & (to_place_m < TOUCHED_M)
        to_edge_m = np.linalg.norm(self._retraction.edge_m_of(seen) + WITHIN_M - seen.poses[:, 0, :3], axis=1)
        force_n = np.linalg.norm(seen.forces_n[:, :2], axis=2).max(axis=1)
        terms = {
            "approach": np.where(held, 0.0, to_edge_m),
            "lift": np.maximum(0.0, LIFTED_M - lifted_m),
            "held": held.astype(np.float64),
            "touch": np.where(is_lifted, to_place_m, 0.04),
            "force": np.maximum(0.0, force_n - FORCE_THRESHOLD_N),
            "success": done.astype(np.float64),
        }
        return terms, done, done

    def _of_grasper(self, episodes: Episodes) -> Episodes:
        """The same as the grasper alone has it, which lifts the edge to above the place."""
        goal_m = np.broadcast_to(EDGE_M + np.array([0.0, -LIFTED_M - 0.006, -0.004]), (len(episodes.steps), 3))
        return Episodes(episodes.hands[:, 0], {"goal_m": goal_m}, episodes.steps, episodes.memory)

    def remember(self, episodes: Episodes, seen: Seen, fresh: NDArray[np.bool_]) -> None:
        self._retraction.remember(self._of_grasper(episodes), seen, fresh)

    def scripted(self, episodes: Episodes, seen: Seen) -> Floats:
        lifting = self._retraction.scripted(self._of_grasper(episodes), seen)
        is_lifted = (seen.n_held[:, 0] > 0) & (self._lifted_m(seen) > LIFTED_M)
        to_m = episodes.goals["place_m"] - episodes.hands[:, 1, :3]
        touching = np.where(is_lifted[:, None], to_m / STRIDE_M, 0.0)
        return np.hstack([lifting, touching])
