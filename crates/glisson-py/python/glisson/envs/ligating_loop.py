"""A loop of thread is put over the end of a stump, drawn tight around a marked place, and tied off."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glisson import Scene, scene_from_dict
from glisson.envs.task import FORCE_THRESHOLD_N, EpisodeTask, Episodes, Floats, Seen, millimetres

#: The stump: its radius, and from its foot to its end, along z [m]. Choices.
RADIUS_M = 0.006
FOOT_M, END_M = -0.024, 0.026
#: Its places that are seen: on its side, from above the foot to its end.
TRACKED_M = np.array([[RADIUS_M, 0.0, z_m] for z_m in (-0.010, 0.0, 0.010, 0.020, END_M)])
#: The mark is between these heights [m].
MARKED_M = (-0.008, 0.006)
#: The open loop, and the tip that draws it [m].
LOOP_M = 0.030
TIP_RADIUS_M = 0.002
#: How far the tip may go [m].
LOWEST_M = np.array([-0.020, -0.045, -0.015])
HIGHEST_M = np.array([0.020, -0.004, 0.060])
#: Tied off within this of the mark, it is well done [m].
TIED_M = 0.005
#: The tip moves so far in a step at most [m], and the lever so much of its way.
STRIDE_M = 0.004
LEVER_STRIDE = 0.1
#: The trigger.
TRIGGER = 8


class LigatingLoop(EpisodeTask):
    """Put the loop over the stump down to the mark, draw it tight and tie it off.

    ``edge_m``: length of the mesh's edges; 4 mm makes 1,312 tetrahedra. The action moves the tip (x, y, z) and the lever, and ties the
    loop off where it is greater than one half. A loop that is tied ends the episode, at the mark or not.
    """

    action_names: tuple[str, ...] = ("x", "y", "z", "lever", "tie")
    observation_names: tuple[str, ...] = (
        *(f"tip_{axis}_m" for axis in "xyz"),
        "lever",
        "tension_n",
        "to_mark_m",
        *(f"place_{i}_{axis}_m" for i in range(len(TRACKED_M)) for axis in "xyz"),
        *(f"force_{axis}_n" for axis in "xyz"),
    )
    default_weights: ClassVar[dict[str, float]] = {
        "approach": -5.0,
        "tight": 0.2,
        "tied": 10.0,
        "beside": -2.0,
        "force": -0.1,
    }
    most_steps = 150

    def __init__(self, *, edge_m: float = 0.004, **options: Any) -> None:
        super().__init__(**options)
        self.edge_m = edge_m

    def scenes(self) -> list[Scene]:
        around = [millimetres(-1.5 * RADIUS_M), millimetres(1.5 * RADIUS_M)]
        ends = [["0 mm", "0 mm", millimetres(z_m)] for z_m in (FOOT_M, END_M)]
        scene = {
            "glisson_scene": 1,
            "name": "Ligating loop",
            "simulation": {"time_step": "10 ms"},
            "organ": {
                "tube": {"path": ends, "radii": [[millimetres(RADIUS_M)]] * 2},
                "edge": millimetres(self.edge_m),
                "tissue": "liver",
                "model": "implicit",
                "law": "stable_neo_hooke",
                "damping": "40 1/s",
                "fixed": [
                    {
                        "box": {
                            "min": [around[0], around[0], millimetres(FOOT_M - 2 * RADIUS_M)],
                            "max": [around[1], around[1], millimetres(FOOT_M + 0.003)],
                        }
                    }
                ],
            },
            "tool": [
                {
                    "name": "ligating loop",
                    "kind": "loop",
                    "tip_radius": millimetres(TIP_RADIUS_M),
                    "loop_diameter": millimetres(LOOP_M),
                    "home_tip": ["0 mm", "-40 mm", "50 mm"],
                    "home_shaft": [0, -1, 0],
                },
            ],
        }
        return [scene_from_dict(scene)]

    def tracked_at_rest_m(self) -> Floats:
        return TRACKED_M

    def begin(self, random: np.random.Generator, variant: int) -> tuple[Floats, dict[str, Floats]]:
        hand = np.zeros(9)
        hand[:3] = random.uniform([-0.012, -0.045, 0.040], [0.012, -0.025, 0.055])
        hand[3:6] = [0.0, -1.0, 0.0]
        hand[7] = 1.0
        return hand, {"mark_m": np.array(random.uniform(*MARKED_M))}

    def move(self, episodes: Episodes, actions: Floats) -> Floats:
        hands = episodes.hands.copy()
        hands[:, :3] = np.clip(hands[:, :3] + STRIDE_M * actions[:, :3], LOWEST_M, HIGHEST_M)
        hands[:, 7] = np.clip(hands[:, 7] + LEVER_STRIDE * actions[:, 3], 0.0, 1.0)
        hands[:, TRIGGER] = actions[:, 4] > 0.5
        return hands

    def _away_m(self, episodes: Episodes, seen: Seen) -> Floats:
        """From the tip to the height of the mark [m]."""
        away_m: Floats = episodes.goals["mark_m"] - seen.poses[:, 0, 2]
        return away_m

    def observe(self, episodes: Episodes, seen: Seen) -> Floats:
        return np.column_stack(
            [
                seen.poses[:, 0, :3],
                seen.poses[:, 0, 7],
                seen.tensions_n[:, 0],
                self._away_m(episodes, seen),
                seen.tracked_m.reshape(len(seen.poses), -1),
                seen.forces_n[:, 0],
            ]
        )

    def remember(self, episodes: Episodes, seen: Seen, fresh: NDArray[np.bool_]) -> None:
        # Where the tip was when the loop became tight: there it is tied.
        height_m = episodes.memory.setdefault("height_m", np.zeros(len(fresh)))
        was_tight = episodes.memory.setdefault("was_tight", np.zeros(len(fresh)))
        was_tight[fresh] = 0.0
        is_tight = (seen.tensions_n[:, 0] > 0.0) | (seen.n_tied > 0)
        begins = is_tight & (was_tight == 0.0)
        height_m[begins] = seen.poses[begins, 0, 2]
        was_tight[:] = is_tight

    def terms(self, episodes: Episodes, seen: Seen, actions: Floats) -> tuple[dict[str, Floats], NDArray[np.bool_], NDArray[np.bool_]]:
        is_over = seen.n_tied > 0
        well = is_over & (np.abs(episodes.memory["height_m"] - episodes.goals["mark_m"]) < TIED_M)
        tight = seen.tensions_n[:, 0] > 0.0
        force_n = np.linalg.norm(seen.forces_n[:, 0], axis=1)
        terms = {
            "approach": np.where(tight | is_over, 0.0, np.abs(self._away_m(episodes, seen))),
            "tight": tight.astype(np.float64),
            "tied": well.astype(np.float64),
            "beside": (is_over & ~well).astype(np.float64),
            "force": np.maximum(0.0, force_n - FORCE_THRESHOLD_N),
        }
        return terms, well, is_over

    def scripted(self, episodes: Episodes, seen: Seen) -> Floats:
        hands_m, lever = episodes.hands[:, :3], episodes.hands[:, 7]
        mark_m = episodes.goals["mark_m"]
        above_m = np.column_stack([np.zeros_like(mark_m), np.full_like(mark_m, -0.5 * LOOP_M), np.full_like(mark_m, END_M + 0.016)])
        down_m, near_m = above_m.copy(), above_m.copy()
        down_m[:, 2] = near_m[:, 2] = mark_m
        # The tip goes to the stump while the loop is drawn.
        near_m[:, 1] = -RADIUS_M - 1.25 * TIP_RADIUS_M
        is_over_it = np.linalg.norm(hands_m[:, :2] - above_m[:, :2], axis=1) < 0.001
        is_down = (np.linalg.norm(hands_m - down_m, axis=1) < 0.001) | (lever < 1.0)
        wanted_m = np.where(is_down[:, None], near_m, np.where(is_over_it[:, None], down_m, above_m))
        pulls = np.where(is_down, -1.0, 1.0)
        tie = np.where(is_down & (lever == 0.0), 1.0, -1.0)
        # Drawn tight it takes a moment until the tissue has given way: the trigger is pressed again and again.
        return np.column_stack([(wanted_m - hands_m) / STRIDE_M, pulls, tie])
