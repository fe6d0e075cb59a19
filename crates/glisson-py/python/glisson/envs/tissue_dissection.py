"""A flap is taken off its bed: the loose tissue between them is parted by a hook, without burning either."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glisson import Scene, scene_from_dict
from glisson.envs.task import FORCE_THRESHOLD_N, ML_PER_M3, EpisodeTask, Episodes, Floats, Seen, block_of_liver, millimetres, remember_steps

#: Half of the length, thickness and width of the flap and of its bed [m], and the gap between them. Choices.
HALF_M = np.array([0.020, 0.0025, 0.015])
GAP_M = 0.007
#: The tip goes in the middle of the gap; how far it may go [m].
LOWEST_M = np.array([-0.022, -0.003, -0.018])
HIGHEST_M = np.array([0.040, 0.003, 0.018])
#: The hook reaches so far around its tip: its radius, and what it burns around it [m].
TIP_RADIUS_M, BURN_M = 0.0015, 0.0015
#: From the tip towards the handle: the shaft lies in the gap.
SHAFT = np.array([1.0, 0.0, 0.0])
#: The tip moves so far in a step at most [m].
STRIDE_M = 0.004


class TissueDissection(EpisodeTask):
    """Part all strands between the flap and its bed with the hook.

    ``edge_m``: length of the mesh's edges; 5 mm makes 480 tetrahedra. The action moves the tip (x, y, z) and switches the current, which is
    on where its last number is greater than one half.
    """

    action_names: tuple[str, ...] = ("x", "y", "z", "current")
    observation_names: tuple[str, ...] = (
        *(f"tip_{axis}_m" for axis in "xyz"),
        "is_on",
        *(f"to_strand_{axis}_m" for axis in "xyz"),
        "share_parted",
        "burnt_ml",
        *(f"force_{axis}_n" for axis in "xyz"),
    )
    default_weights: ClassVar[dict[str, float]] = {
        "approach": -2.0,
        "progress": 10.0,
        "burnt": -10.0,
        "force": -0.1,
        "success": 10.0,
    }
    most_steps = 200

    def __init__(self, *, edge_m: float = 0.005, **options: Any) -> None:
        super().__init__(**options)
        self.edge_m = edge_m

    def scenes(self) -> list[Scene]:
        away_m = HALF_M[1] + 0.5 * GAP_M
        flap, bed = (block_of_liver(HALF_M, self.edge_m, np.array([0.0, y_m, 0.0])) for y_m in (-away_m, away_m))
        behind = millimetres(away_m + HALF_M[1] - 0.001)
        far = [millimetres(2 * x_m) for x_m in HALF_M]
        bed |= {"name": "bed", "fixed": [{"box": {"min": [f"-{far[0]}", behind, f"-{far[2]}"], "max": [far[0], "100 mm", far[2]]}}]}
        return [
            scene_from_dict(
                {
                    "glisson_scene": 1,
                    "name": "Tissue dissection",
                    "simulation": {"time_step": "5 ms"},
                    "task": {
                        "title": "Take the flap off its bed",
                        "stage": [{"title": "Part what holds it", "detach": {"body": "flap", "from": "bed"}}],
                    },
                    "organ": [bed, flap | {"name": "flap"}],
                    "attachment": [
                        {
                            "body": "flap",
                            "to": "bed",
                            "kind": "glue",
                            "reach": millimetres(1.2 * GAP_M),
                            "stiffness": "600 N/m",
                            "damping": "20 ms",
                            "cut": True,
                        }
                    ],
                    "tool": [
                        {
                            "name": "hook",
                            "kind": "hook",
                            "tip_radius": millimetres(TIP_RADIUS_M),
                            "shaft_radius": "1 mm",
                            "burns": "swept",
                            "burn_depth": millimetres(BURN_M),
                            "home_tip": ["40 mm", "0 mm", "0 mm"],
                            "home_shaft": SHAFT.tolist(),
                        },
                    ],
                }
            )
        ]

    def tracked_at_rest_m(self) -> Floats:
        # The side of the flap that is held.
        return np.array([[x_m, -0.5 * GAP_M, 0.0] for x_m in (-0.015, 0.0, 0.015)])

    def begin(self, random: np.random.Generator, variant: int) -> tuple[Floats, dict[str, Floats]]:
        hand = np.zeros(9)
        hand[:3] = random.uniform([0.028, -0.003, -0.015], [0.040, 0.003, 0.015])
        hand[3:6] = SHAFT
        return hand, {}

    def move(self, episodes: Episodes, actions: Floats) -> Floats:
        hands = episodes.hands.copy()
        hands[:, :3] = np.clip(hands[:, :3] + STRIDE_M * actions[:, :3], LOWEST_M, HIGHEST_M)
        hands[:, 8] = actions[:, 3] > 0.5
        return hands

    def remember(self, episodes: Episodes, seen: Seen, fresh: NDArray[np.bool_]) -> None:
        remember_steps(episodes.memory, fresh, parted=seen.share_done, burnt_ml=ML_PER_M3 * seen.removed_m3)

    def observe(self, episodes: Episodes, seen: Seen) -> Floats:
        tip_m = seen.poses[:, 0, :3]
        return np.column_stack(
            [
                tip_m,
                seen.poses[:, 0, 8],
                seen.strands_m[:, 0] - tip_m,
                episodes.memory["parted"],
                episodes.memory["burnt_ml"],
                seen.forces_n[:, 0],
            ]
        )

    def terms(self, episodes: Episodes, seen: Seen, actions: Floats) -> tuple[dict[str, Floats], NDArray[np.bool_], NDArray[np.bool_]]:
        done, memory = seen.is_done, episodes.memory
        terms = {
            "approach": np.linalg.norm(seen.strands_m[:, 0] - seen.poses[:, 0, :3], axis=1),
            "progress": memory["parted_step"],
            "burnt": memory["burnt_ml_step"],
            "force": np.maximum(0.0, np.linalg.norm(seen.forces_n[:, 0], axis=1) - FORCE_THRESHOLD_N),
            "success": done.astype(np.float64),
        }
        return terms, done, done

    def scripted(self, episodes: Episodes, seen: Seen) -> Floats:
        """To the middle of the gap, and from strand to nearest strand."""
        hands_m = episodes.hands[:, :3]
        to_m = seen.strands_m[:, 0] - hands_m
        to_m[:, 1] = -hands_m[:, 1]
        is_level = np.abs(hands_m[:, 1]) < 1e-4
        to_m[~is_level] *= np.array([0.0, 1.0, 0.0])
        return np.column_stack([to_m / STRIDE_M, np.where(is_level, 1.0, -1.0)])
