"""A flap of tissue is taken at its free edge and lifted, so that what lies below it is seen."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glisson import Scene, scene_from_dict
from glisson.envs.task import FORCE_THRESHOLD_N, EpisodeTask, Episodes, Floats, Seen, block_of_liver, millimetres

#: Half of the flap's length, thickness and width [m]. A choice.
HALF_M = np.array([0.030, 0.003, 0.020])
#: The middle of the free edge at rest is between these points [m].
EDGE_SIDES_M = np.array([[0.0, -HALF_M[1], HALF_M[2]], [0.0, HALF_M[1], HALF_M[2]]])
EDGE_M = EDGE_SIDES_M.mean(axis=0)
#: The jaws hold it when the tip is so far within the edge [m].
WITHIN_M = np.array([0.0, 0.0, -0.005])
#: How far the tip may go from the middle of the workspace [m].
LOWEST_M = np.array([-0.020, -0.040, 0.0])
HIGHEST_M = np.array([0.020, 0.010, 0.060])
#: From the tip towards the handle, and how the jaws are turned about it [rad].
SHAFT = np.array([0.0, -0.3, 1.0]) / np.hypot(0.3, 1.0)
ROLL_RAD = np.pi / 2
#: The point that is held has to come so near to its goal [m].
REACHED_M = 0.004
#: The tip moves so far in a step at most [m], and the jaws so much of their opening.
STRIDE_M = 0.004
JAW_STRIDE = 0.25


class TissueRetraction(EpisodeTask):
    """Take the flap's free edge and lift it to the goal.

    ``edge_m``: length of the mesh's edges; 5 mm makes 480 tetrahedra. The action moves the tip (x, y, z) and the jaws.
    """

    action_names: tuple[str, ...] = ("x", "y", "z", "jaws")
    observation_names: tuple[str, ...] = (
        *(f"tip_{axis}_m" for axis in "xyz"),
        "jaws",
        "is_held",
        *(f"to_edge_{axis}_m" for axis in "xyz"),
        *(f"edge_to_goal_{axis}_m" for axis in "xyz"),
        *(f"force_{axis}_n" for axis in "xyz"),
    )
    default_weights: ClassVar[dict[str, float]] = {
        "approach": -5.0,
        "lift": -10.0,
        "held": 0.2,
        "force": -0.1,
        "success": 10.0,
    }

    def __init__(self, *, edge_m: float = 0.005, **options: Any) -> None:
        super().__init__(**options)
        self.edge_m = edge_m

    def scenes(self) -> list[Scene]:
        return [scene_from_dict(self.scene())]

    def scene(self) -> dict[str, Any]:
        """The flap and its grasper."""
        margin = 1.5 * self.edge_m
        return {
            "glisson_scene": 1,
            "name": "Tissue retraction",
            "simulation": {"time_step": "10 ms"},
            "organ": {
                **block_of_liver(HALF_M, self.edge_m),
                "fixed": [
                    {"box": {"min": [millimetres(-0.1)] * 3, "max": [millimetres(0.1), millimetres(0.1), millimetres(-HALF_M[2] + 0.5 * margin)]}},
                ],
            },
            "tool": [
                {
                    "name": "grasper",
                    "kind": "grasper",
                    "tip_radius": "1.5 mm",
                    "jaw_length": "12 mm",
                    "closing_force": "8 N",
                    "friction": 0.8,
                    "home_tip": ["0 mm", "-10 mm", "50 mm"],
                    "home_shaft": SHAFT.tolist(),
                    # The jaws open up and down, around the flap.
                    "home_roll": f"{np.degrees(ROLL_RAD)} deg",
                    "home_jaw": 1,
                },
            ],
        }

    def tracked_at_rest_m(self) -> Floats:
        return EDGE_SIDES_M

    def begin(self, random: np.random.Generator, variant: int) -> tuple[Floats, dict[str, Floats]]:
        hand = np.zeros(9)
        hand[:3] = random.uniform([-0.015, -0.020, 0.035], [0.015, 0.0, 0.055])
        hand[3:6] = SHAFT
        hand[6] = ROLL_RAD
        hand[7] = 1.0
        goal_m = EDGE_M + random.uniform([-0.008, -0.024, -0.010], [0.008, -0.014, 0.0])
        return hand, {"goal_m": goal_m}

    def move(self, episodes: Episodes, actions: Floats) -> Floats:
        hands = episodes.hands.copy()
        hands[:, :3] = np.clip(hands[:, :3] + STRIDE_M * actions[:, :3], LOWEST_M, HIGHEST_M)
        hands[:, 7] = np.clip(hands[:, 7] + JAW_STRIDE * actions[:, 3], 0.0, 1.0)
        return hands

    def edge_m_of(self, seen: Seen) -> Floats:
        """The middle of the free edge [m]."""
        edge_m: Floats = seen.tracked_m.mean(axis=1)
        return edge_m

    def observe(self, episodes: Episodes, seen: Seen) -> Floats:
        tip_m, edge_m = seen.poses[:, 0, :3], self.edge_m_of(seen)
        jaws, held = seen.poses[:, 0, 7:8], (seen.n_held[:, :1] > 0).astype(np.float64)
        to_goal_m = episodes.goals["goal_m"] - edge_m
        return np.hstack([tip_m, jaws, held, edge_m - tip_m, to_goal_m, seen.forces_n[:, 0]])

    def terms(self, episodes: Episodes, seen: Seen, actions: Floats) -> tuple[dict[str, Floats], NDArray[np.bool_], NDArray[np.bool_]]:
        return self.terms_for(np.linalg.norm(episodes.goals["goal_m"] - self.edge_m_of(seen), axis=1), seen)

    def terms_for(self, to_goal_m: Floats, seen: Seen) -> tuple[dict[str, Floats], NDArray[np.bool_], NDArray[np.bool_]]:
        """The terms where what is moved is so far from its goal [m]."""
        tip_m, edge_m = seen.poses[:, 0, :3], self.edge_m_of(seen)
        held = seen.n_held[:, 0] > 0
        done = held & (to_goal_m < REACHED_M)
        force_n = np.linalg.norm(seen.forces_n[:, 0], axis=1)
        terms = {
            "approach": np.where(held, 0.0, np.linalg.norm(edge_m + WITHIN_M - tip_m, axis=1)),
            "lift": to_goal_m,
            "held": held.astype(np.float64),
            "force": np.maximum(0.0, force_n - FORCE_THRESHOLD_N),
            "success": done.astype(np.float64),
        }
        return terms, done, done

    def remember(self, episodes: Episodes, seen: Seen, fresh: NDArray[np.bool_]) -> None:
        opens = episodes.memory.setdefault("opens", np.zeros(len(fresh)))
        jaws, held = episodes.hands[:, 7], seen.n_held[:, 0] > 0
        opens[(jaws == 0.0) & ~held] = 1.0
        opens[fresh | (jaws == 1.0)] = 0.0

    def scripted(self, episodes: Episodes, seen: Seen) -> Floats:
        return self.scripted_for(episodes.goals["goal_m"] - self.edge_m_of(seen), episodes, seen)

    def scripted_for(self, to_goal_m: Floats, episodes: Episodes, seen: Seen) -> Floats:
        """The edge is taken, and moved this way [m] while it is held."""
        hands_m, edge_m = episodes.hands[:, :3], self.edge_m_of(seen)
        held = seen.n_held[:, 0] > 0
        opens = episodes.memory["opens"] > 0
        # Before the edge first, so that it comes between the jaws; then in, and together.
        to_grip_m = edge_m + WITHIN_M - hands_m
        is_aligned = (np.linalg.norm(to_grip_m[:, :2], axis=1) < 0.001) & ~opens
        before_m = to_grip_m + np.where(is_aligned, 0.0, 0.020)[:, None] * np.array([0.0, 0.0, 1.0])
        # What began to close goes on, unless it is far off, or closed on nothing: then they open for another try.
        is_closing = (episodes.hands[:, 7] < 1.0) & ~opens
        away_m = np.linalg.norm(to_grip_m, axis=1)
        near = (away_m < np.where(is_closing, 0.010, 0.0015)) & ~opens
        way_m = np.where(held[:, None], to_goal_m, np.where(near[:, None], 0.0, before_m))
        jaws = np.where(held | near, -1.0, 1.0)
        return np.hstack([np.clip(way_m / STRIDE_M, -1.0, 1.0), jaws[:, None]])
