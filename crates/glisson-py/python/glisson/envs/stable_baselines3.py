"""Environments for Stable-Baselines3 (https://stable-baselines3.readthedocs.io), stepped together on threads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv  # type: ignore[import-not-found, import-untyped, unused-ignore]

from glisson.envs.task import EpisodeTask
from glisson.envs.vector import TissueVectorEnv


class StableVecEnv(VecEnv):  # type: ignore[misc, unused-ignore]
    """What ``glisson.envs.make_vec`` gives as a ``VecEnv``: ``PPO("MlpPolicy", StableVecEnv(envs))``.

    The environments have to begin anew in the step that ends them (``autoreset_mode=AutoresetMode.SAME_STEP``).
    """

    def __init__(self, envs: TissueVectorEnv) -> None:
        if envs.autoreset_mode != AutoresetMode.SAME_STEP:
            raise ValueError("give environments of autoreset_mode=AutoresetMode.SAME_STEP")
        self.envs = envs
        self.render_mode = envs.render_mode
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._actions: NDArray[np.float32] = np.zeros(envs.action_space.shape or (), np.float32)
        self._returns, self._lengths = np.zeros(envs.num_envs), np.zeros(envs.num_envs, dtype=np.int64)

    @property
    def task(self) -> EpisodeTask:
        return self.envs.batch.task

    def reset(self) -> Any:
        # Seeds are used once, as Stable-Baselines3 says.
        seeds = list(self._seeds) if any(seed is not None for seed in self._seeds) else None
        observed, _ = self.envs.reset(seed=seeds)
        self._reset_seeds()
        self._returns[:], self._lengths[:] = 0.0, 0
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return observed

    def step_async(self, actions: NDArray[np.float32]) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        observed, rewards, ended, cut_off, told = self.envs.step(self._actions)
        over = ended | cut_off
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": bool(cut_off[i] and not ended[i])} for i in range(self.num_envs)]
        for i in np.flatnonzero(over):
            last = told["final_info"]
            infos[i] |= {name: float(values[i]) for name, values in last.items() if not name.startswith("_")}
            infos[i]["is_success"] = bool(last["is_success"][i])
            infos[i]["terminal_observation"] = told["final_obs"][i]
            infos[i]["episode"] = {"r": float(self._returns[i]), "l": int(self._lengths[i])}
        self._returns[over], self._lengths[over] = 0.0, 0
        return observed, rewards.astype(np.float32), over, infos

    def close(self) -> None:
        self.envs.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        return self.envs.render() or [None] * self.num_envs

    def _chosen(self, indices: Any) -> range | list[int]:
        return list(self._get_indices(indices))

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.envs, attr_name) for _ in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError("the environments of a batch have no attributes of their own")

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **named: Any) -> list[Any]:
        raise NotImplementedError("the environments of a batch have no methods of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False for _ in self._chosen(indices)]
