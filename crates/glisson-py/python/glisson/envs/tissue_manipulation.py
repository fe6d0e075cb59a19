"""A place of the tissue is brought to a place in space, by pulling at the tissue where the hand finds it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glisson.envs.task import Episodes, Floats, Seen
from glisson.envs.tissue_retraction import EDGE_SIDES_M, HALF_M, TissueRetraction

#: The place that is to be moved: below the edge, to its left and to its right [m].
PLACES_M = np.array([[x_m, -HALF_M[1], HALF_M[2] - 0.010] for x_m in (-0.012, 0.012)])


class TissueManipulation(TissueRetraction):
    """Take the flap's free edge, and move it so that a place below it, which is not held, comes to its goal.

    ``edge_m``: length of the mesh's edges; 5 mm makes 480 tetrahedra. The action moves the tip (x, y, z) and the jaws. Which of two
    places is to be moved differs from episode to episode.
    """

    observation_names: tuple[str, ...] = (
        *(f"tip_{axis}_m" for axis in "xyz"),
        "jaws",
        "is_held",
        *(f"to_edge_{axis}_m" for axis in "xyz"),
        *(f"place_{axis}_m" for axis in "xyz"),
        *(f"place_to_goal_{axis}_m" for axis in "xyz"),
        *(f"force_{axis}_n" for axis in "xyz"),
    )

    def tracked_at_rest_m(self) -> Floats:
        return np.vstack([EDGE_SIDES_M, PLACES_M])

    def begin(self, random: np.random.Generator, variant: int) -> tuple[Floats, dict[str, Floats]]:
        hand, _ = super().begin(random, variant)
        which = int(random.integers(len(PLACES_M)))
        goal_m = PLACES_M[which] + random.uniform([-0.004, -0.014, -0.003], [0.004, -0.008, 0.0])
        return hand, {"goal_m": goal_m, "which": np.array(float(which))}

    def edge_m_of(self, seen: Seen) -> Floats:
        edge_m: Floats = seen.tracked_m[:, : len(EDGE_SIDES_M)].mean(axis=1)
        return edge_m

    def _place_m(self, episodes: Episodes, seen: Seen) -> Floats:
        which = len(EDGE_SIDES_M) + episodes.goals["which"].astype(np.int64)
        place_m: Floats = seen.tracked_m[np.arange(len(which)), which]
        return place_m

    def _to_goal_m(self, episodes: Episodes, seen: Seen) -> Floats:
        return episodes.goals["goal_m"] - self._place_m(episodes, seen)

    def observe(self, episodes: Episodes, seen: Seen) -> Floats:
        tip_m, held = seen.poses[:, 0, :3], (seen.n_held[:, :1] > 0).astype(np.float64)
        place_m, to_goal_m = self._place_m(episodes, seen), self._to_goal_m(episodes, seen)
        jaws = seen.poses[:, 0, 7:8]
        return np.hstack([tip_m, jaws, held, self.edge_m_of(seen) - tip_m, place_m, to_goal_m, seen.forces_n[:, 0]])

    def terms(self, episodes: Episodes, seen: Seen, actions: Floats) -> tuple[dict[str, Floats], NDArray[np.bool_], NDArray[np.bool_]]:
        return self.terms_for(np.linalg.norm(self._to_goal_m(episodes, seen), axis=1), seen)

    def scripted(self, episodes: Episodes, seen: Seen) -> Floats:
        return self.scripted_for(self._to_goal_m(episodes, seen), episodes, seen)
