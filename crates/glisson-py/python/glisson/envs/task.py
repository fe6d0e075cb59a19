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
#: Millilitres in a cubic metre.
ML_PER_M3 = 1e6


def millimetres(x_m: float) -> str:
    """A length as a scene file has it."""
    return f"{1e3 * x_m:.4f} mm"


def block_of_liver(half_m: Floats, edge_m: float, middle_m: Floats | None = None) -> dict[str, Any]:
    """The organ of a scene: a block around a place (the origin, if not given), half as long as this along each axis; what holds it is to
    be added."""
    around_m = np.zeros(3) if middle_m is None else middle_m
    return {
        "box": {"min": [millimetres(x_m) for x_m in around_m - half_m], "max": [millimetres(x_m) for x_m in around_m + half_m]},
        "edge": millimetres(edge_m),
        "tissue": "liver",
        "model": "implicit",
        "law": "stable_neo_hooke",
        "damping": "20 1/s",
    }


def remember_steps(memory: dict[str, Floats], fresh: NDArray[np.bool_], **now: Floats) -> None:
    """Remembers what something is now, under its name, and what it grew by since the last step, under ``NAME_step``."""
    for name, value in now.items():
        last, step = memory.setdefault(name, value.copy()), memory.setdefault(f"{name}_step", np.zeros(len(fresh)))
        step[:] = np.where(fresh, 0.0, value - last)
        last[:] = value


@dataclass
class Episodes:
    """Where the episodes of all environments are; the first axis is that of the environments."""

    #: Where the hands are wanted: (n, 9) of the first instrument, or (n, hands, 9) of the first ones of a task with several.
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
    #: Tension of each instrument's loop of thread [N], (n, instruments).
    tensions_n: Floats
    #: Loops that are tied off, (n,).
    n_tied: NDArray[np.uint32]
    #: How far the scene's task is: stages done, stages in all, share of the stage, mistakes, (n, 4).
    progress: Floats
    #: The first, the middle and the last point of what the scene's task marks [m], at rest, (n, 3, 3).
    marks_m: Floats
    #: Middle of the strand between bodies that is nearest to each instrument's tip [m], (n, instruments, 3); the tip where there is none.
    strands_m: Floats
    #: Blood lost and tissue taken out [m3], (n,).
    blood_lost_m3: Floats
    removed_m3: Floats

    @property
    def share_done(self) -> Floats:
        """Share of the scene's task that is done, (n,)."""
        share: Floats = (self.progress[:, 0] + self.progress[:, 2]) / np.maximum(self.progress[:, 1], 1.0)
        return share

    @property
    def is_done(self) -> NDArray[np.bool_]:
        """Whether all stages of the scene's task are, (n,)."""
        done: NDArray[np.bool_] = self.progress[:, 0] >= np.maximum(self.progress[:, 1], 1.0)
        return done


class EpisodeTask(abc.ABC):
    """A task in episodes. Subclass it to make an environment of your own."""

    #: How many instruments the actions move, the first ones of the scene; others stay where they are.
    hands: int = 1
    #: Names of what an action moves, each from -1 to 1.
    action_names: tuple[str, ...]
    #: Names of the numbers of an observation.
    observation_names: tuple[str, ...]
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
        """An episode in the scene of that number: where the hand begins, (9,), or the hands, (hands, 9), and what it is about."""

    @abc.abstractmethod
    def move(self, episodes: Episodes, actions: Floats) -> Floats:
        """Where the hands are wanted after these actions, as ``episodes.hands``."""

    def agents(self) -> dict[str, list[int]]:
        """Which numbers of an action each of several agents has, by their names; all for one, unless a task says so here."""
        return {"surgeon": list(range(len(self.action_names)))}

    def clips(self, actions: Floats) -> NDArray[np.bool_]:
        """Which hands set a clip after the step, (n, hands); none unless a task says so here."""
        return np.zeros((len(actions), self.hands), dtype=bool)

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
