"""Learns an environment with PPO (Schulman et al. 2017, arXiv 1707.06347) and says how often it succeeds.

    python learn.py TissueRetraction --out out/learn

It needs glisson, gymnasium and stable-baselines3. Writes ENVIRONMENT.csv (the curve), ENVIRONMENT.zip (the policy) and
ENVIRONMENT.json (seed, steps, time, success in episodes that it did not learn from).
"""

from __future__ import annotations

import argparse
import csv
import json
import pathlib
import time

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

import glisson.envs
from glisson.envs.stable_baselines3 import StableVecEnv

#: Episodes that success is a share of, and the first of their seeds; those of learning are others.
N_TESTED, FIRST_TESTED = 200, 1_000_000


class Curve(BaseCallback):
    """Writes down how episodes ended, and stops when the time is over."""

    def __init__(self, path: pathlib.Path, enough: float, most_s: float) -> None:
        super().__init__()
        self.path, self.enough, self.most_s = path, enough, most_s
        self.began_s = time.perf_counter()
        self.last: list[tuple[float, float, bool]] = []
        self.rows: list[dict[str, float]] = []

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                self.last.append((info["episode"]["r"], info["episode"]["l"], info["is_success"]))
        return not self.is_over()

    def _on_rollout_end(self) -> None:
        if not self.last:
            return
        returns, lengths, successes = (np.array(column, dtype=float) for column in zip(*self.last))
        row = {
            "steps": self.num_timesteps,
            "time_s": round(time.perf_counter() - self.began_s, 1),
            "episodes": len(self.last),
            "mean_return": round(float(returns.mean()), 3),
            "mean_length": round(float(lengths.mean()), 1),
            "success": round(float(successes.mean()), 4),
        }
        self.rows.append(row)
        self.last = []
        print(" ".join(f"{name} {value}" for name, value in row.items()), flush=True)
        with self.path.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(row))
            writer.writeheader()
            writer.writerows(self.rows)

    def is_enough(self) -> bool:
        recent = self.rows[-3:]
        return len(recent) == 3 and all(row["success"] >= self.enough for row in recent)

    def is_over(self) -> bool:
        return time.perf_counter() - self.began_s > self.most_s


def tested(name: str, policy: PPO, statistics: VecNormalize) -> float:
    """Share of successes in episodes of seeds that it did not learn from, without noise in its actions."""
    envs = glisson.envs.make_vec(name, 50, autoreset_mode=AutoresetMode.DISABLED)
    n_good = 0
    for first in range(FIRST_TESTED, FIRST_TESTED + N_TESTED, 50):
        seen, _ = envs.reset(seed=first)
        going = np.ones(50, dtype=bool)
        while going.any():
            actions, _ = policy.predict(statistics.normalize_obs(seen), deterministic=True)
            seen, _, ended, cut_off, infos = envs.step(np.clip(actions, -1.0, 1.0))
            over = going & (ended | cut_off)
            n_good += int((infos["is_success"] & over).sum())
            going &= ~over
            # What is over begins anew, and does not count.
            if (ended | cut_off).any():
                seen, _ = envs.reset(options={"reset_mask": ended | cut_off})
    return n_good / N_TESTED


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("environment", choices=sorted(glisson.envs.TASKS))
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("out/learn"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--envs", type=int, default=32)
    parser.add_argument("--minutes", type=float, default=30.0, help="it learns no longer than that")
    parser.add_argument("--enough", type=float, default=0.97, help="nor when so many episodes of three rollouts succeed")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    # Networks so small are faster on one core; the other steps environments.
    torch.set_num_threads(1)
    envs = glisson.envs.make_vec(chosen.environment, chosen.envs, autoreset_mode=AutoresetMode.SAME_STEP)
    normalized = VecNormalize(StableVecEnv(envs), gamma=0.98)
    policy = PPO(
        "MlpPolicy",
        normalized,
        n_steps=64,
        batch_size=512,
        n_epochs=8,
        gamma=0.98,
        learning_rate=5e-4,
        ent_coef=0.0,
        policy_kwargs={"log_std_init": -0.5, "net_arch": [128, 128]},
        seed=chosen.seed,
        device="cpu",
    )
    curve = Curve(chosen.out / f"{chosen.environment}.csv", chosen.enough, 60.0 * chosen.minutes)
    while not curve.is_enough() and not curve.is_over():
        policy.learn(8 * 64 * chosen.envs, callback=curve, reset_num_timesteps=False)
    learnt_s = round(time.perf_counter() - curve.began_s, 1)
    normalized.training = False
    success = tested(chosen.environment, policy, normalized)
    policy.save(chosen.out / f"{chosen.environment}.zip")
    normalized.save(str(chosen.out / f"{chosen.environment}.normalized.pkl"))
    result = {
        "environment": chosen.environment,
        "glisson": glisson.__version__,
        "seed": chosen.seed,
        "environments": chosen.envs,
        "steps": policy.num_timesteps,
        "learnt_s": learnt_s,
        "tested_episodes": N_TESTED,
        "success": success,
    }
    (chosen.out / f"{chosen.environment}.json").write_text(json.dumps(result, indent=2) + "\n")
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
