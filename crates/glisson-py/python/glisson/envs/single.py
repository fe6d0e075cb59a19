"""An environment of one world."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from glisson.envs.task import EpisodeTask
from glisson.envs.vector import EpisodeBatch

_THIS = np.ones(1, dtype=bool)


class TissueEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """One environment of a task (gymnasium.Env)."""

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, task: EpisodeTask, *, render_mode: str | None = None) -> None:
        if render_mode is not None:
            raise ValueError(f"there is no render_mode {render_mode!r}: pictures are not made yet")
        self.batch = EpisodeBatch(task, 1, 1)
        self.render_mode = render_mode
        self.observation_space = self.batch.observation_space
        self.action_space = self.batch.action_space

    @property
    def task(self) -> EpisodeTask:
        return self.batch.task

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[NDArray[np.float32], dict[str, Any]]:
        super().reset(seed=seed)
        self.batch.seed([seed])
        self.batch.begin(_THIS)
        return self.batch.observed[0].copy(), {}

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        rewards, terms, reached, done, cut_off = self.batch.step(np.asarray(action)[None], _THIS)
        info: dict[str, Any] = {f"reward_{name}": float(term[0]) for name, term in terms.items()}
        info["is_success"] = bool(reached[0])
        return self.batch.observed[0].copy(), float(rewards[0]), bool(done[0]), bool(cut_off[0]), info

    def scripted_action(self) -> NDArray[np.float32]:
        """What who knows all would do now: a demonstration."""
        return self.batch.scripted_actions()[0].astype(np.float32)

    def close(self) -> None:
        self.batch.close()
