"""What is done in an environment: the scenes, what is observed, what is rewarded. All for many worlds at once, in arrays."""

from __future__ import annotations

import abc
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glisson import Scene

Floats = NDArray[np.float64]


#: The grip on liver that forceps had on average (doi 10.1080/13645706.2020.1755313) [N].
FORCE_THRESHOLD_N = 1.75


def millimetres(x_m: float) -> str:
    """A length as a scene file has it."""
    return f"{1e3 * x_m:.4f} mm"


def block_of_liver(half_m: Floats, edge_m: float) -> dict[str, Any]:
    """The organ of a scene: a block around the origin, half as long as this along each axis; what holds it is to be added."""
    return {
        "box": {"min": [millimetres(-x_m) for x_m in half_m], "max": [millimetres(x_m) for x_m in half_m]},
        "edge": millimetres(edge_m),
        "tissue": "liver",
        "model": "implicit",
        "law": "stable_neo_hooke",
        "damping": "20 1/s",
    }


@dataclass
class Episodes:
    """Where the episodes of all environments are; the first axis is that of the environments."""

    #: Where the hand of the first instrument is wanted, (n, 9).
    hands: Floats
    #: What the episode is about, drawn at its start, (n, ...).
    goals: dict[str, Floats]
    #: Steps made, (n,).
    steps: NDArray[np.int64]
    #: What a task remembers from step to step, (n, ...).
    memory: dict[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class Seen:
    """What is in the worlds after a step; the first axis is that of the environments."""

    #: Where the instruments are, (n, instruments, 9).
    poses: Floats
    #: Force of the tissue on each [N], (n, instruments, 3).
    forces_n: Floats
    #: Nodes that their jaws hold, (n, instruments).
    n_held: NDArray[np.uint32]
    #: Tracked points of the tissue [m], (n, points, 3).
    tracked_m: Floats


class EpisodeTask(abc.ABC):
    """A task in episodes. Subclass it to make an environment of your own."""

    #: Names of what an action moves, each from -1 to 1.
    action_names: ClassVar[tuple[str, ...]]
    #: Names of the numbers of an observation.
    observation_names: ClassVar[tuple[str, ...]]
    #: How much each term of the reward weighs; change it with the option ``reward_weights``.
    default_weights: ClassVar[dict[str, float]]
    #: Rate at which actions are taken, in simulated time [Hz].
    control_rate_hz: ClassVar[float] = 20.0
    #: An episode is cut off after so many steps.
    most_steps: int = 200

    def __init__(self, *, reward_weights: dict[str, float] | None = None, most_steps: int | None = None) -> None:
        unknown = set(reward_weights or {}) - set(self.default_weights)
        if unknown:
            terms = ", ".join(self.default_weights)
            raise ValueError(f"no term of the reward is called {', '.join(sorted(unknown))}; there are: {terms}")
        self.reward_weights = {**self.default_weights, **(reward_weights or {})}
        if most_steps is not None:
            if most_steps < 1:
                raise ValueError(f"most_steps is {most_steps}; give 1 or more")
            self.most_steps = most_steps

    @abc.abstractmethod
    def scenes(self) -> list[Scene]:
        """The scenes, of which each episode takes one."""

    @abc.abstractmethod
    def tracked_at_rest_m(self) -> Floats:
        """Points of the tissue whose places are seen [m], (points, 3)."""

    @abc.abstractmethod
    def begin(self, random: np.random.Generator, variant: int) -> tuple[Floats, dict[str, Floats]]:
        """An episode in the scene of that number: where the hand begins, (9,), and what it is about."""

    @abc.abstractmethod
    def move(self, episodes: Episodes, actions: Floats) -> Floats:
        """Where the hands are wanted after these actions, (n, 9)."""

    @abc.abstractmethod
    def observe(self, episodes: Episodes, seen: Seen) -> Floats:
        """What is observed, (n, len(observation_names))."""

    @abc.abstractmethod
    def terms(self, episodes: Episodes, seen: Seen, actions: Floats) -> tuple[dict[str, Floats], NDArray[np.bool_], NDArray[np.bool_]]:
        """The terms of the reward before they are weighed, each (n,), which episodes have reached their goal, and which are over."""

    def remember(self, episodes: Episodes, seen: Seen, fresh: NDArray[np.bool_]) -> None:
        """Brings ``episodes.memory`` up to date; ``fresh``: those that begin. Nothing is remembered unless a task does it here."""

    @abc.abstractmethod
    def scripted(self, episodes: Episodes, seen: Seen) -> Floats:
        """The actions of who knows all, (n, actions): the task can be done."""
