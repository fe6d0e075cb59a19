"""What an environment observes: the numbers of its task, and by choice forces, stress, damage, points, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Union

import gymnasium
import numpy as np
from numpy.typing import NDArray

from glisson import Worlds
from glisson.envs.task import EpisodeTask

#: An array, or an array by name.
Observed = Union[NDArray[Any], dict[str, NDArray[Any]]]

#: What can be observed.
KINDS: dict[str, str] = {
    "state": "the numbers of the task, (observation_names,)",
    "wrench": "force [N] and torque about the tip [N m] on each instrument that the actions move, (hands, 6)",
    "strain": "equivalent strain at the points that the task tracks, (points,)",
    "stress": "von Mises stress at the points that the task tracks [Pa], (points,)",
    "damage": "greatest strain of the surface, its area strained beyond 0.47 [m2], tissue taken out [m3], blood lost [m3], (4,)",
    "cloud": "points of the surface as it is drawn [m], (n_points, 3)",
    "rgb": "a picture, (height, width, 3) bytes",
    "depth": "how deep along the view what each of its pixels shows is [m], 0 where there is nothing, (height, width)",
    "segmentation": "what it is, (height, width): 0 nothing, 1 instruments, 2 threads, clips, strands, blood, 3 faces of cuts, "
    "4 and more the skin of the bodies",
}
#: What pictures are made of.
_LAYERS = ("depth", "segmentation")


class Observation:
    """The choice of what is observed.

    ``kinds``: names of :data:`KINDS`; ``("state",)`` alone is an array, all else a dictionary of arrays by these names.
    ``picture_size``: width and height of pictures [pixels]; ``view``: "outside" or "endoscope"; ``n_points``: of a cloud.
    """

    def __init__(
        self,
        kinds: Sequence[str] = ("state",),
        *,
        picture_size: tuple[int, int] = (64, 64),
        view: str = "outside",
        n_points: int = 256,
    ) -> None:
        kinds = [kinds] if isinstance(kinds, str) else list(kinds)
        unknown = [kind for kind in kinds if kind not in KINDS]
        if unknown or not kinds:
            raise ValueError(f"observe is {kinds}; choose of: {', '.join(KINDS)}")
        if min(picture_size) < 1 or n_points < 1:
            raise ValueError(f"picture_size is {picture_size} and n_points {n_points}; give 1 or more")
        self.kinds, self.picture_size, self.view, self.n_points = kinds, picture_size, view, n_points

    def space(self, task: EpisodeTask) -> gymnasium.spaces.Space[Any]:
        """What observations of one environment are."""
        width, height = self.picture_size
        n_tracked = len(task.tracked_at_rest_m())

        def numbers(*shape: int, low: float = -np.inf) -> gymnasium.spaces.Box:
            return gymnasium.spaces.Box(low, np.inf, shape, np.float32)

        def of_bytes(*shape: int) -> gymnasium.spaces.Box:
            return gymnasium.spaces.Box(0, 255, shape, np.uint8)

        spaces: dict[str, gymnasium.spaces.Space[Any]] = {
            "state": numbers(len(task.observation_names)),
            "wrench": numbers(task.hands, 6),
            "strain": numbers(n_tracked, low=0.0),
            "stress": numbers(n_tracked, low=0.0),
            "damage": numbers(4),
            "cloud": numbers(self.n_points, 3),
            "rgb": of_bytes(height, width, 3),
            "depth": numbers(height, width, low=0.0),
            "segmentation": of_bytes(height, width),
        }
        if self.kinds == ["state"]:
            return spaces["state"]
        return gymnasium.spaces.Dict({kind: spaces[kind] for kind in self.kinds})

    def read(self, state: NDArray[np.float32], worlds: Worlds, active: NDArray[np.int64], hands: int) -> Observed:
        """What is observed in the worlds ``active``, one for each environment, whose first instruments are the hands."""
        if self.kinds == ["state"]:
            return state
        seen: dict[str, NDArray[Any]] = {}
        places = active.tolist()
        if any(kind in _LAYERS for kind in self.kinds):
            seen["depth"], seen["segmentation"] = worlds.layers(*self.picture_size, view=self.view, worlds=places)
        for kind in self.kinds:
            if kind not in seen:
                seen[kind] = self._one(kind, state, worlds, active, hands)
        return {kind: seen[kind] for kind in self.kinds}

    def _one(self, kind: str, state: NDArray[np.float32], worlds: Worlds, active: NDArray[np.int64], hands: int) -> NDArray[Any]:
        if kind == "state":
            return state
        if kind == "rgb":
            return worlds.pictures(*self.picture_size, view=self.view, worlds=active.tolist())
        if kind == "wrench":
            values = np.concatenate([worlds.forces_n, worlds.torques_n_m], axis=2)[active, :hands]
        elif kind == "strain":
            values = worlds.tracked_strain(active.tolist())
        elif kind == "stress":
            values = worlds.tracked_stress_pa(active.tolist())
        elif kind == "damage":
            values = worlds.damages(active.tolist())
        else:
            values = worlds.clouds(self.n_points, active.tolist())
        return values.astype(np.float32)
