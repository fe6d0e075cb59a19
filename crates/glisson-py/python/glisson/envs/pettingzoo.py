"""Environments of two hands as environments of two agents, with the parallel API of PettingZoo (https://pettingzoo.farama.org)."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from pettingzoo import ParallelEnv  # type: ignore[import-untyped]

from glisson.envs.single import TissueEnv


class TissueParallelEnv(ParallelEnv):  # type: ignore[misc]
    """An agent for each hand: all see the same, and each moves its own instrument. The reward, and the end, are those of all.

    ``env``: what ``glisson.envs.make`` gives; its task names the agents (``task.agents``).
    """

    def __init__(self, env: TissueEnv) -> None:
        self._env = env
        self._places = {agent: np.array(places) for agent, places in env.task.agents().items()}
        self.possible_agents = list(self._places)
        self.agents: list[str] = []
        self.render_mode = env.render_mode
        self.metadata = {"name": f"glisson_{type(env.task).__name__}", **env.metadata}
        self.observation_spaces = {agent: env.observation_space for agent in self.possible_agents}
        self.action_spaces = {
            agent: gymnasium.spaces.Box(-1.0, 1.0, places.shape, np.float32) for agent, places in self._places.items()
        }

    def observation_space(self, agent: str) -> gymnasium.spaces.Space[Any]:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.spaces.Space[Any]:
        return self.action_spaces[agent]

    def _for_each(self, value: Any) -> dict[str, Any]:
        return dict.fromkeys(self.agents, value)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
        observed, info = self._env.reset(seed=seed, options=options)
        self.agents = list(self.possible_agents)
        return self._for_each(observed), {agent: dict(info) for agent in self.agents}

    def step(
        self, actions: dict[str, NDArray[np.float32]]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]:
        """A step; who says nothing keeps its instrument where it is."""
        action = np.zeros(self._env.action_space.shape or (), np.float32)
        for agent, of_agent in actions.items():
            action[self._places[agent]] = of_agent
        observed, reward, done, cut_off, info = self._env.step(action)
        told = (
            self._for_each(observed),
            self._for_each(reward),
            self._for_each(done),
            self._for_each(cut_off),
            {agent: dict(info) for agent in self.agents},
        )
        if done or cut_off:
            self.agents = []
        return told

    def scripted_actions(self) -> dict[str, NDArray[np.float32]]:
        """What who knows all would do now: a demonstration."""
        action = self._env.scripted_action()
        return {agent: action[places] for agent, places in self._places.items()}

    def render(self) -> NDArray[np.uint8] | None:
        return self._env.render()

    def close(self) -> None:
        self._env.close()
