"""A hard nodule lies in a block of tissue: it is felt with a probe, and its place is marked."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glisson import Scene, scene_from_dict
from glisson.envs.task import FORCE_THRESHOLD_N, EpisodeTask, Episodes, Floats, Seen, block_of_liver, millimetres

#: Half of the block's length, depth and width [m]. A choice.
HALF_M = np.array([0.030, 0.010, 0.030])
#: The nodule, and how deep its middle is below the front [m]; it is as hard as that of the task `palpation`.
NODULE_RADIUS_M = 0.008
NODULE_DEPTH_M = 0.009
#: Its middle is at one of these places along the block, and across it [m].
PLACES_M = np.array([-0.016, 0.0, 0.016])
TIP_RADIUS_M = 0.004
#: The tip's middle stays so far from the block's, and before its front [m].
ASIDE_M = 0.024
OUT_M, IN_M = 0.010, -0.001
#: Marked within this of the nodule's middle, along the front, it is found [m].
FOUND_M = 0.008
#: The tip moves so far in a step at most: along the front, and into it [m].
STRIDE_M, PRESS_M = 0.004, 0.002
#: Below this depth nothing is said of stiffness [m].
LEAST_DEPTH_M = 0.001


class Palpation(EpisodeTask):
    """Press here and there, and mark the place where it is hardest.

    ``edge_m``: length of the mesh's edges; 6.5 mm makes 1,215 tetrahedra. The action moves the tip along the front (x, z), presses, and
    marks where it is greater than one half and the tip is in the tissue. A mark ends the episode, right or wrong.
    """

    action_names: tuple[str, ...] = ("x", "z", "press", "mark")
    observation_names: tuple[str, ...] = (
        "tip_x_m",
        "tip_z_m",
        "depth_m",
        *(f"force_{axis}_n" for axis in "xyz"),
        "stiffness_n_per_m",
        "hardest_n_per_m",
        "to_hardest_x_m",
        "to_hardest_z_m",
        "share_of_steps",
    )
    default_weights: ClassVar[dict[str, float]] = {"found": 10.0, "wrong": -1.0, "away": -1.0, "time": -0.02, "force": -0.1}
    most_steps = 150

    def __init__(self, *, edge_m: float = 0.0065, **options: Any) -> None:
        super().__init__(**options)
        self.edge_m = edge_m

    def nodule_m(self, variant: int) -> Floats:
        """Where its middle is at rest [m]."""
        return np.array([PLACES_M[variant % 3], -HALF_M[1] + NODULE_DEPTH_M, PLACES_M[variant // 3]])

    def scenes(self) -> list[Scene]:
        return [self._scene(variant) for variant in range(len(PLACES_M) ** 2)]

    def _scene(self, variant: int) -> Scene:
        nodule = {"center": [millimetres(x_m) for x_m in self.nodule_m(variant)], "radius": millimetres(NODULE_RADIUS_M)}
        return scene_from_dict(
            {
                "glisson_scene": 1,
                "name": "Palpation of a block",
                "simulation": {"time_step": "10 ms"},
                "organ": {
                    **block_of_liver(HALF_M, self.edge_m),
                    "fixed": [{"furthest": {"direction": [0, 1, 0], "fraction": 0.2}}],
                    "part": [{"ball": nodule, "young_modulus": "50 kPa", "poisson_ratio": 0.45}],
                },
                "tool": [
                    {
                        "name": "probe",
                        "kind": "probe",
                        "tip_radius": millimetres(TIP_RADIUS_M),
                        "friction": 0.3,
                        "home_tip": ["0 mm", millimetres(-HALF_M[1] - OUT_M), "0 mm"],
                        "home_shaft": [0, -1, 0],
                    },
                ],
            }
        )

    def tracked_at_rest_m(self) -> Floats:
        return np.array([[0.0, -HALF_M[1], 0.0]])

    def begin(self, random: np.random.Generator, variant: int) -> tuple[Floats, dict[str, Floats]]:
        hand = np.zeros(9)
        hand[:3] = [*random.uniform(-ASIDE_M, ASIDE_M, 1), -HALF_M[1] - OUT_M, *random.uniform(-ASIDE_M, ASIDE_M, 1)]
        hand[3:6] = [0.0, -1.0, 0.0]
        return hand, {"nodule_m": self.nodule_m(variant)}

    def move(self, episodes: Episodes, actions: Floats) -> Floats:
        hands = episodes.hands.copy()
        for axis, action in ((0, 0), (2, 1)):
            hands[:, axis] = np.clip(hands[:, axis] + STRIDE_M * actions[:, action], -ASIDE_M, ASIDE_M)
        hands[:, 1] = np.clip(hands[:, 1] + PRESS_M * actions[:, 2], -HALF_M[1] - OUT_M, -HALF_M[1] - IN_M)
        return hands

    def _depth_m(self, seen: Seen) -> Floats:
        """How far the tip is in the front as it is at rest [m]; negative before it."""
        depth_m: Floats = seen.poses[:, 0, 1] + TIP_RADIUS_M + HALF_M[1]
        return depth_m

    def remember(self, episodes: Episodes, seen: Seen, fresh: NDArray[np.bool_]) -> None:
        n = len(fresh)
        stiffness = episodes.memory.setdefault("stiffness", np.zeros(n))
        hardest = episodes.memory.setdefault("hardest", np.zeros(n))
        place_m = episodes.memory.setdefault("hardest_m", np.zeros((n, 2)))
        tip_m, depth_m = seen.poses[:, 0, [0, 2]], self._depth_m(seen)
        presses = depth_m > LEAST_DEPTH_M
        stiffness[:] = np.where(presses, np.linalg.norm(seen.forces_n[:, 0], axis=1) / np.maximum(depth_m, LEAST_DEPTH_M), 0.0)
        hardest[fresh] = 0.0
        place_m[fresh] = tip_m[fresh]
        is_harder = stiffness > hardest
        hardest[is_harder], place_m[is_harder] = stiffness[is_harder], tip_m[is_harder]

    def observe(self, episodes: Episodes, seen: Seen) -> Floats:
        tip_m, memory = seen.poses[:, 0, [0, 2]], episodes.memory
        return np.column_stack(
            [
                tip_m,
                self._depth_m(seen),
                seen.forces_n[:, 0],
                memory["stiffness"],
                memory["hardest"],
                memory["hardest_m"] - tip_m,
                episodes.steps / self.most_steps,
            ]
        )

    def terms(self, episodes: Episodes, seen: Seen, actions: Floats) -> tuple[dict[str, Floats], NDArray[np.bool_], NDArray[np.bool_]]:
        away_m = np.linalg.norm(seen.poses[:, 0, [0, 2]] - episodes.goals["nodule_m"][:, [0, 2]], axis=1)
        marks = (actions[:, 3] > 0.5) & (self._depth_m(seen) > LEAST_DEPTH_M)
        found = marks & (away_m < FOUND_M)
        force_n = np.linalg.norm(seen.forces_n[:, 0], axis=1)
        terms = {
            "found": found.astype(np.float64),
            "wrong": (marks & ~found).astype(np.float64),
            "away": away_m,
            "time": np.ones(len(marks)),
            "force": np.maximum(0.0, force_n - FORCE_THRESHOLD_N),
        }
        return terms, found, marks

    def scripted(self, episodes: Episodes, seen: Seen) -> Floats:
        to_m = episodes.goals["nodule_m"][:, [0, 2]] - episodes.hands[:, [0, 2]]
        is_above = np.linalg.norm(to_m, axis=1) < 0.002
        is_in = self._depth_m(seen) > 0.003
        press = np.where(is_above, 1.0, -1.0)
        mark = np.where(is_above & is_in, 1.0, -1.0)
        return np.column_stack([to_m / STRIDE_M, press, mark])
