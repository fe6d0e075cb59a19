"""An environment of one world."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from glisson.envs.observations import Observation
from glisson.envs.task import EpisodeTask
from glisson.envs.vector import RENDER_MODES, EpisodeBatch, checked_render_mode

_THIS = np.ones(1, dtype=bool)


class TissueEnv(gymnasium.Env[Any, NDArray[np.float32]]):
    """One environment of a task (gymnasium.Env)."""

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES}

    def __init__(self, task: EpisodeTask, *, render_mode: str | None = None, observation: Observation | None = None) -> None:
        self.render_mode = checked_render_mode(render_mode)
        self.batch = EpisodeBatch(task, 1, 1, observation or Observation())
        self.metadata = {**self.metadata, "render_fps": task.control_rate_hz}
        # Until it is reset.
        self._is_over = True
        self.observation_space = self.batch.observation_space
        self.action_space = self.batch.action_space

    @property
    def task(self) -> EpisodeTask:
        return self.batch.task

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.batch.randoms[0] = self.np_random
        self.batch.begin(_THIS)
        self._is_over = False
        return self.batch.observed_by(0), {}

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        if self._is_over:
            raise gymnasium.error.ResetNeeded("call reset before the first step, and after the last one of an episode")
        rewards, terms, reached, done, cut_off = self.batch.step(np.asarray(action)[None], _THIS)
        info: dict[str, Any] = {f"reward_{name}": float(term[0]) for name, term in terms.items()}
        self._is_over = bool(done[0] or cut_off[0])
        info["is_success"] = bool(reached[0])
        return self.batch.observed_by(0), float(rewards[0]), bool(done[0]), bool(cut_off[0]), info

    def scripted_action(self) -> NDArray[np.float32]:
        """What who knows all would do now: a demonstration."""
        if self._is_over:
            raise gymnasium.error.ResetNeeded("call reset first")
        action: NDArray[np.float32] = self.batch.scripted_actions()[0].astype(np.float32)
        return action

    def render(self) -> NDArray[np.uint8] | None:
        return self.batch.pictures()[0] if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        self.batch.close()
