"""Many environments at once, stepped on threads without Python's lock."""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from glisson import Worlds
from glisson.envs.observations import Observation, Observed
from glisson.envs.task import EpisodeTask, Episodes, Floats, Seen


RENDER_MODES = ["rgb_array"]


def checked_render_mode(mode: str | None) -> str | None:
    if mode is not None and mode not in RENDER_MODES:
        raise ValueError(f"there is no render_mode {mode!r}; there is: {', '.join(RENDER_MODES)}")
    return mode


#: Width and height of pictures [pixels].
PICTURE_SIZE = (320, 240)


class Stepped(NamedTuple):
    """What came of a step, each (environments,)."""

    rewards: Floats
    terms: dict[str, Floats]
    #: Which have reached their goal.
    reached: NDArray[np.bool_]
    #: Which are over, and which were cut off after their most steps.
    over: NDArray[np.bool_]
    cut_off: NDArray[np.bool_]


class EpisodeBatch:
    """The episodes of a task in many worlds: what environments of one world and of many share."""

    def __init__(self, task: EpisodeTask, num_envs: int, threads: int | None, observation: Observation) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs is {num_envs}; give 1 or more")
        scenes = task.scenes()
        self.task, self.n, self.n_variants = task, num_envs, len(scenes)
        self._worlds: Worlds | None = Worlds(scenes * num_envs, threads=threads)
        self._worlds.track(task.tracked_at_rest_m())
        time_step_s = scenes[0].time_step_s
        self.steps_per_action = max(1, round(1.0 / (task.control_rate_hz * time_step_s)))
        # The world of each environment.
        self.active = np.arange(num_envs) * self.n_variants
        self.randoms = [np_random()[0] for _ in range(num_envs)]
        of_hands = (9,) if task.hands == 1 else (task.hands, 9)
        self.episodes = Episodes(np.zeros((num_envs, *of_hands)), {}, np.zeros(num_envs, dtype=np.int64))
        self.seen: Seen
        self.observation = observation
        #: What is observed now.
        self.observed: Observed
        self.observation_space = observation.space(task)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(task.action_names),), np.float32)

    @property
    def worlds(self) -> Worlds:
        if self._worlds is None:
            raise RuntimeError("this environment was closed: make another one")
        return self._worlds

    def close(self) -> None:
        self._worlds = None

    def seed(self, i: int, seed: int | None) -> None:
        """The episodes of an environment are drawn by this seed from now on; None: as until now."""
        if seed is not None:
            self.randoms[i] = np_random(seed)[0]

    def begin(self, which: NDArray[np.bool_]) -> None:
        """New episodes in some environments."""
        numbers = np.flatnonzero(which)
        if numbers.size == 0:
            return
        for i in numbers:
            variant = int(self.randoms[i].integers(self.n_variants))
            hand, goals = self.task.begin(self.randoms[i], variant)
            self.active[i] = i * self.n_variants + variant
            self.episodes.hands[i] = hand
            for name, goal in goals.items():
                kept = self.episodes.goals.setdefault(name, np.zeros((self.n, *np.shape(goal))))
                kept[i] = goal
        self.episodes.steps[numbers] = 0
        places = self.active[numbers].tolist()
        self.worlds.restart(places)
        self.worlds.place(self._poses(places, numbers), places)
        self._look(which, which)

    def _look(self, moved: NDArray[np.bool_], fresh: NDArray[np.bool_]) -> None:
        """Sees all; those that did not move have remembered this moment already."""
        worlds, active, memory = self.worlds, self.active, self.episodes.memory
        self.seen = Seen(
            worlds.poses[active],
            worlds.forces_n[active],
            worlds.n_held[active],
            worlds.tracked_m[active],
            worlds.loop_tensions_n[active],
            worlds.n_tied_loops[active],
            worlds.task_progress[active],
            worlds.task_marks_m[active],
            worlds.nearest_strands_m[active],
            worlds.blood_lost_m3[active],
            worlds.removed_volumes_m3[active],
        )
        remembered = {name: values[~moved].copy() for name, values in memory.items()}
        self.task.remember(self.episodes, self.seen, fresh)
        for name, values in remembered.items():
            memory[name][~moved] = values
        state = self.task.observe(self.episodes, self.seen).astype(np.float32)
        rows = np.flatnonzero(moved)
        if not hasattr(self, "observed") or rows.size == self.n:
            self.observed = self.observation.read(state, worlds, active, self.task.hands)
        elif rows.size > 0:
            # The others see what they saw.
            self._exchange(rows, self.observation.read(state[rows], worlds, active[rows], self.task.hands))

    def _exchange(self, rows: NDArray[np.int64], fresh: Observed) -> None:
        observed = self.observed_by_all()
        if isinstance(observed, dict) and isinstance(fresh, dict):
            for name, values in fresh.items():
                observed[name][rows] = values
        elif not isinstance(observed, dict) and not isinstance(fresh, dict):
            observed[rows] = fresh
        self.observed = observed

    def observed_by(self, i: int) -> Observed:
        """What one environment observes, of its own."""
        if isinstance(self.observed, dict):
            return {name: values[i].copy() for name, values in self.observed.items()}
        one: NDArray[Any] = self.observed[i].copy()
        return one

    def observed_by_all(self) -> Observed:
        """What all observe, of their own."""
        if isinstance(self.observed, dict):
            return {name: values.copy() for name, values in self.observed.items()}
        return self.observed.copy()

    def _poses(self, places: list[int], which: NDArray[Any]) -> Floats:
        """All instruments of some worlds, the hands where they are wanted."""
        poses = self.worlds.poses[places]
        poses[:, : self.task.hands] = self.episodes.hands[which].reshape(len(places), self.task.hands, 9)
        return poses

    def step(self, actions: NDArray[Any], which: NDArray[np.bool_]) -> Stepped:
        """A step in some environments."""
        actions = np.asarray(actions, dtype=np.float64)
        expected = (self.n, len(self.task.action_names))
        if actions.shape != expected:
            raise ValueError(f"actions have the shape {actions.shape}, and {expected} is expected: {', '.join(self.task.action_names)}")
        if not np.isfinite(actions).all():
            raise ValueError("an action is not finite")
        actions = np.clip(actions, -1.0, 1.0)
        wanted = self.task.move(self.episodes, actions)
        self.episodes.hands[which] = wanted[which]
        places = self.active[which].tolist()
        if places:
            self.worlds.step(self._poses(places, which), self.steps_per_action, places)
            clips = self.task.clips(actions) & which[:, None]
            for hand in np.flatnonzero(clips.any(axis=0)):
                self.worlds.clip(int(hand), self.active[clips[:, hand]].tolist())
        self.episodes.steps[which] += 1
        self._look(which, np.zeros(self.n, dtype=bool))
        terms, reached, over = self.task.terms(self.episodes, self.seen, actions)
        rewards = sum((self.task.reward_weights[name] * term for name, term in terms.items()), start=np.zeros(self.n))
        cut_off = ~over & (self.episodes.steps >= self.task.most_steps)
        return Stepped(rewards, terms, reached, over, cut_off)

    def pictures(self) -> NDArray[np.uint8]:
        """Each environment as it is now, (environments, height, width, 3)."""
        return self.worlds.pictures(*PICTURE_SIZE, worlds=self.active.tolist())

    def scripted_actions(self) -> Floats:
        """What who knows all would do now."""
        return np.clip(self.task.scripted(self.episodes, self.seen), -1.0, 1.0)


class TissueVectorEnv(gymnasium.vector.VectorEnv[Any, NDArray[np.float32], NDArray[Any]]):
    """Many environments of a task (gymnasium.vector.VectorEnv)."""

    def __init__(
        self,
        task: EpisodeTask,
        num_envs: int,
        *,
        threads: int | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        observation: Observation | None = None,
    ) -> None:
        self.render_mode = checked_render_mode(render_mode)
        self.batch = EpisodeBatch(task, num_envs, threads, observation or Observation())
        self.num_envs = num_envs
        self.metadata = {"autoreset_mode": AutoresetMode(autoreset_mode), "render_modes": RENDER_MODES, "render_fps": task.control_rate_hz}
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.single_observation_space = self.batch.observation_space
        self.single_action_space = self.batch.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._over: NDArray[np.bool_] = np.zeros(num_envs, dtype=bool)
        self._begun = False

    def reset(self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """New episodes in all environments, or in those of ``options={"reset_mask": ...}``."""
        if isinstance(seed, (int, np.integer)):
            super().reset(seed=int(seed))
            seed = [int(seed) + i for i in range(self.num_envs)]
        seeds: list[int | None] = [None] * self.num_envs if seed is None else list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds for {self.num_envs} environments")
        which: NDArray[np.bool_] = np.ones(self.num_envs, dtype=bool)
        if options is not None and "reset_mask" in options:
            which = np.asarray(options["reset_mask"])
            if which.dtype != np.bool_ or which.shape != (self.num_envs,):
                raise ValueError(f"reset_mask is an array of {self.num_envs} booleans")
            if not self._begun and not which.all():
                raise ValueError("the first reset is one of all environments")
        for i in np.flatnonzero(which):
            self.batch.seed(int(i), seeds[i])
        self.batch.begin(which)
        self._over[which] = False
        self._begun = True
        return self.batch.observed_by_all(), {}

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """A step in all environments; what becomes of those whose episode is over says ``autoreset_mode``."""
        if not self._begun:
            raise gymnasium.error.ResetNeeded("call reset before the first step")
        over = self._over.copy()
        if self.autoreset_mode == AutoresetMode.DISABLED and over.any():
            raise gymnasium.error.ResetNeeded(f"the episodes of {np.flatnonzero(over).tolist()} are over: reset them with options={{'reset_mask': ...}}")
        going = ~over
        rewards, terms, reached, done, cut_off = self.batch.step(actions, going)
        rewards[over], done[over], cut_off[over] = 0.0, False, False
        infos: dict[str, Any] = {}
        for name, term in terms.items():
            self._add(infos, f"reward_{name}", term, going)
        self._add(infos, "is_success", reached & going, going)
        self._over = done | cut_off
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:
            self.batch.begin(over)
        elif self.autoreset_mode == AutoresetMode.SAME_STEP and self._over.any():
            final = np.full(self.num_envs, None, dtype=object)
            for i in np.flatnonzero(self._over):
                final[i] = self.batch.observed_by(int(i))
            ended = self._over.copy()
            final_info = {key: value.copy() for key, value in infos.items() if not key.startswith("_")}
            final_info |= {f"_{key}": ended for key in final_info}
            # What was said of the last step of an episode is there alone.
            for name in [name for name in infos if name.startswith("_")]:
                infos[name] &= ~ended
            self._add(infos, "final_obs", final, ended)
            infos["final_info"], infos["_final_info"] = final_info, ended
            self.batch.begin(ended)
            self._over[:] = False
        return self.batch.observed_by_all(), rewards, done, cut_off, infos

    @staticmethod
    def _add(infos: dict[str, Any], name: str, values: NDArray[Any], which: NDArray[np.bool_]) -> None:
        infos[name], infos[f"_{name}"] = values, which.copy()

    def scripted_actions(self) -> NDArray[np.float32]:
        """What who knows all would do now: a demonstration."""
        return self.batch.scripted_actions().astype(np.float32)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        return tuple(self.batch.pictures()) if self.render_mode == "rgb_array" else None

    def close_extras(self, **kwargs: Any) -> None:
        self.batch.close()
