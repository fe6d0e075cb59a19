"""A plate of tissue is cut along a marked line with a scalpel."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glisson import Scene, scene_from_dict
from glisson.envs.task import FORCE_THRESHOLD_N, EpisodeTask, Episodes, Floats, Seen, block_of_liver, millimetres, remember_steps

#: Half of the plate's length, thickness and width [m]. A choice.
HALF_M = np.array([0.030, 0.002, 0.020])
#: The lines: where they begin and end in the plate's front, along x and z [m].
LINES_M = np.array(
    [
        [[-0.016, 0.0], [0.016, 0.0]],
        [[-0.016, -0.006], [0.016, 0.006]],
        [[-0.016, 0.006], [0.016, -0.006]],
        [[0.016, 0.005], [-0.012, -0.008]],
        [[0.014, -0.007], [-0.016, 0.004]],
    ]
)
#: A cut counts within this of the line [m], and so much of it is to be cut.
WITHIN_M = 0.003
SHARE = 0.9
#: How far the tip may go [m]; along y from before the plate to behind it.
LOWEST_M = np.array([-0.026, -0.030, -0.016])
HIGHEST_M = np.array([0.026, 0.008, 0.016])
#: The tip moves so far in a step at most [m].
STRIDE_M = 0.004
#: Where the demonstration leads the tip before and behind the plate, and how far beyond the line's end [m].
BEFORE_M, BEHIND_M, BEYOND_M = -0.008, 0.006, 0.003


class PrecisionCutting(EpisodeTask):
    """Cut along the line, through the plate's thickness, and nowhere else. There are five lines.

    ``edge_m``: length of the mesh's edges; 5 mm makes 480 tetrahedra. The action moves the tip (x, y, z), and the scalpel cuts where its
    last number is greater than one half.
    """

    action_names: tuple[str, ...] = ("x", "y", "z", "cut")
    observation_names: tuple[str, ...] = (
        *(f"tip_{axis}_m" for axis in "xyz"),
        "is_cutting",
        "to_start_x_m",
        "to_start_z_m",
        "to_end_x_m",
        "to_end_z_m",
        "off_line_m",
        "share_cut",
        *(f"force_{axis}_n" for axis in "xyz"),
    )
    default_weights: ClassVar[dict[str, float]] = {
        "approach": -5.0,
        "progress": 10.0,
        "beside": -1.0,
        "force": -0.1,
        "success": 10.0,
    }
    most_steps = 100

    def __init__(self, *, edge_m: float = 0.005, **options: Any) -> None:
        super().__init__(**options)
        self.edge_m = edge_m

    def scenes(self) -> list[Scene]:
        return [self._scene(line_m) for line_m in LINES_M]

    def _scene(self, line_m: Floats) -> Scene:
        start, end = ([millimetres(x_m), millimetres(-HALF_M[1]), millimetres(z_m)] for x_m, z_m in line_m)
        lowest, highest = [millimetres(-1.1 * x_m) for x_m in HALF_M], [millimetres(1.1 * x_m) for x_m in HALF_M]
        inner_m = millimetres(HALF_M[0] - 0.003)
        return scene_from_dict(
            {
                "glisson_scene": 1,
                "name": "Precision cutting",
                "simulation": {"time_step": "5 ms"},
                "task": {
                    "title": "Cut along the line",
                    "stage": [{"title": "Cut along the line", "cut": {"from": start, "to": end, "within": millimetres(WITHIN_M), "share": SHARE}}],
                },
                "organ": {
                    **block_of_liver(HALF_M, self.edge_m),
                    "fixed": [
                        {"box": {"min": lowest, "max": [f"-{inner_m}", *highest[1:]]}},
                        {"box": {"min": [inner_m, *lowest[1:]], "max": highest}},
                    ],
                },
                "tool": [
                    {
                        "name": "scalpel",
                        "kind": "scalpel",
                        "tip_radius": "0.5 mm",
                        "shaft_radius": "1 mm",
                        "blade_length": "15 mm",
                        "home_tip": ["0 mm", "-30 mm", "0 mm"],
                        "home_shaft": [0, -1, 0],
                    },
                ],
            }
        )

    def tracked_at_rest_m(self) -> Floats:
        return np.array([[x_m, -HALF_M[1], 0.0] for x_m in (-0.015, 0.0, 0.015)])

    def begin(self, random: np.random.Generator, variant: int) -> tuple[Floats, dict[str, Floats]]:
        hand = np.zeros(9)
        hand[:3] = random.uniform([-0.020, -0.028, -0.012], [0.020, -0.015, 0.012])
        hand[3:6] = [0.0, -1.0, 0.0]
        return hand, {"line_m": LINES_M[variant]}

    def move(self, episodes: Episodes, actions: Floats) -> Floats:
        hands = episodes.hands.copy()
        hands[:, :3] = np.clip(hands[:, :3] + STRIDE_M * actions[:, :3], LOWEST_M, HIGHEST_M)
        hands[:, 8] = actions[:, 3] > 0.5
        return hands

    def _off_line_m(self, episodes: Episodes, tip_m: Floats) -> Floats:
        """How far tips are from their line, along the plate [m]."""
        start_m, end_m = episodes.goals["line_m"][:, 0], episodes.goals["line_m"][:, 1]
        along_m, to_tip_m = end_m - start_m, tip_m[:, [0, 2]] - start_m
        share = np.clip((to_tip_m * along_m).sum(axis=1) / (along_m**2).sum(axis=1), 0.0, 1.0)
        off_m: Floats = np.linalg.norm(to_tip_m - share[:, None] * along_m, axis=1)
        return off_m

    def remember(self, episodes: Episodes, seen: Seen, fresh: NDArray[np.bool_]) -> None:
        remember_steps(episodes.memory, fresh, cut=seen.share_done)
        is_in = episodes.memory.setdefault("is_in", np.zeros(len(fresh)))
        is_in[episodes.hands[:, 1] > BEHIND_M - 1e-6] = 1.0
        is_in[fresh] = 0.0

    def observe(self, episodes: Episodes, seen: Seen) -> Floats:
        tip_m, line_m = seen.poses[:, 0, :3], episodes.goals["line_m"]
        return np.column_stack(
            [
                tip_m,
                seen.poses[:, 0, 8],
                line_m[:, 0] - tip_m[:, [0, 2]],
                line_m[:, 1] - tip_m[:, [0, 2]],
                self._off_line_m(episodes, tip_m),
                episodes.memory["cut"],
                seen.forces_n[:, 0],
            ]
        )

    def terms(self, episodes: Episodes, seen: Seen, actions: Floats) -> tuple[dict[str, Floats], NDArray[np.bool_], NDArray[np.bool_]]:
        tip_m, done = seen.poses[:, 0, :3], seen.is_done
        cuts = (seen.poses[:, 0, 8] > 0.5) & (tip_m[:, 1] > -HALF_M[1])
        to_start_m = np.hypot(np.linalg.norm(episodes.goals["line_m"][:, 0] - tip_m[:, [0, 2]], axis=1), tip_m[:, 1] + HALF_M[1])
        terms = {
            "approach": np.where(episodes.memory["cut"] > 0.0, 0.0, to_start_m),
            "progress": episodes.memory["cut_step"],
            "beside": (cuts & (self._off_line_m(episodes, tip_m) > 1.5 * WITHIN_M)).astype(np.float64),
            "force": np.maximum(0.0, np.linalg.norm(seen.forces_n[:, 0], axis=1) - FORCE_THRESHOLD_N),
            "success": done.astype(np.float64),
        }
        return terms, done, done

    def scripted(self, episodes: Episodes, seen: Seen) -> Floats:
        hands_m, line_m = episodes.hands[:, :3], episodes.goals["line_m"]
        is_in = episodes.memory["is_in"] > 0.0
        along = line_m[:, 1] - line_m[:, 0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        # A little before where the line begins: in there, and along it to a little beyond its end.
        begins_m, ends_m = line_m[:, 0] - BEYOND_M * along, line_m[:, 1] + BEYOND_M * along
        is_above = np.linalg.norm(begins_m - hands_m[:, [0, 2]], axis=1) < 1e-4
        wanted_m = np.where(is_in[:, None], ends_m, begins_m)
        deep_m = np.where(is_in | is_above, BEHIND_M, BEFORE_M)
        way_m = np.column_stack([wanted_m[:, 0], deep_m, wanted_m[:, 1]]) - hands_m
        # Along the line, not along the axes.
        stretch = np.maximum(1.0, np.abs(way_m).max(axis=1) / STRIDE_M)
        return np.column_stack([way_m / (STRIDE_M * stretch[:, None]), np.where(is_in | is_above, 1.0, -1.0)])
