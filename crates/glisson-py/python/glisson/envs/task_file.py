"""Any task file as an environment: its stages are what is rewarded, its demonstration is who knows all."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glisson import Scene, task_names
from glisson.envs.task import FORCE_THRESHOLD_N, ML_PER_M3, EpisodeTask, Episodes, Floats, Seen, remember_steps

#: What an action moves of a hand at most in a step: the tip [m], its shaft's direction, its roll [rad], its jaws.
TIP_STRIDE_M = 0.010
SHAFT_STRIDE = 0.15
ROLL_STRIDE_RAD = 0.15
JAW_STRIDE = 0.25
#: Where episodes begin differs by so much along each axis [m].
ASIDE_M = 0.003
#: A hand is where the demonstration has it within this [m], and this [rad, and shares of the jaws' opening].
NEAR_M = 1e-4
NEAR_RAD = 1e-2

_POSE = (*(f"tip_{axis}" for axis in "xyz"), *(f"shaft_{axis}" for axis in "xyz"), "roll", "jaws", "trigger")
_STRIDES = np.array([TIP_STRIDE_M] * 3 + [SHAFT_STRIDE] * 3 + [ROLL_STRIDE_RAD, JAW_STRIDE])


class TaskFile(EpisodeTask):
    """A task of the program (``task="cut_off"``; :func:`glisson.task_names`) or of a file of your own (``task="my_task.toml"``).

    ``patients``: the seeds of the patients, of which each episode has one; ``level``: its level. The actions move the instruments that the
    demonstration moves: tip (x, y, z), shaft (x, y, z, and then made a direction), roll, jaws, trigger (on above one half), and for clip
    appliers whether a clip is set (above one half). All stages done is success; the gate of the task's report is not looked at.
    """

    default_weights: ClassVar[dict[str, float]] = {
        "progress": 10.0,
        "mistake": -1.0,
        "blood": -0.1,
        "force": -0.1,
        "success": 10.0,
    }

    def __init__(
        self,
        *,
        task: str | os.PathLike[str] = "cut_off",
        level: str | None = None,
        patients: Sequence[int | None] = (None,),
        **options: Any,
    ) -> None:
        super().__init__(**options)
        if not patients:
            raise ValueError("patients is empty; give one seed or more, or None for the task's own")
        self._scenes = [self._scene(task, level, patient) for patient in patients]
        scene = self._scenes[0]
        ends_s = scene.demonstration_ends_s
        if ends_s is None:
            raise ValueError(f"{task}: no instrument has a path, and what an environment's hands are is said by the demonstration")
        if not scene.has_task:
            raise ValueError(f"{task}: the scene has no [task], and nothing says what is to be done")
        n_times = max(1, math.ceil(ends_s * self.control_rate_hz))
        led = np.stack([scene.demonstration(ends_s * i / n_times) for i in range(n_times + 1)])
        moves = (np.ptp(led, axis=0) > 0.0).any(axis=1)
        if not moves.any():
            raise ValueError(f"{task}: the paths of its instruments move none of them")
        # The first instruments, up to the last one that is moved.
        self.hands = int(np.flatnonzero(moves).max()) + 1
        self._is_clipping = [kind == "clipper" for kind in scene.tool_kinds[: self.hands]]
        self._names = [name.replace(" ", "_") for name in scene.tool_names[: self.hands]]
        if len(set(self._names)) < self.hands:
            raise ValueError(f"{task}: two instruments have the same name: {', '.join(self._names)}")
        actions, seen = [], []
        for name, sets_clips in zip(self._names, self._is_clipping):
            actions += [f"{name}_{number}" for number in _POSE] + ([f"{name}_clip"] if sets_clips else [])
            seen += [f"{name}_{number}" for number in _POSE] + [f"{name}_{number}" for number in ("is_held", "force_x_n", "force_y_n", "force_z_n")]
        marks = [f"mark_{point}_{axis}_m" for point in ("first", "middle", "last") for axis in "xyz"]
        self.action_names = tuple(actions)
        self.observation_names = (*seen, *marks, "share_done", "share_of_stage", "mistakes", "share_of_steps")
        # Where the numbers of each hand's pose are among the actions, and whether it sets a clip.
        places = np.cumsum([0] + [len(_POSE) + sets_clips for sets_clips in self._is_clipping])[:-1]
        self._of_pose = places[:, None] + np.arange(len(_POSE))
        self._of_clip = places + len(_POSE)
        if options.get("most_steps") is None:
            self.most_steps = max(self.most_steps, math.ceil(2.0 * ends_s * self.control_rate_hz))

    def _scene(self, task: str | os.PathLike[str], level: str | None, patient: int | None) -> Scene:
        if os.fspath(task) in task_names():
            return Scene.task(os.fspath(task), level, patient)
        if level is not None or patient is not None:
            raise ValueError(f"{task}: levels and patients are chosen of the tasks of the program alone: {', '.join(task_names())}")
        return Scene.load(task)

    def agents(self) -> dict[str, list[int]]:
        ends = [*self._of_pose[1:, 0], len(self.action_names)]
        return {name: list(range(first, end)) for name, first, end in zip(self._names, self._of_pose[:, 0], ends)}

    def scenes(self) -> list[Scene]:
        return self._scenes

    def tracked_at_rest_m(self) -> Floats:
        # The surface nodes nearest to where the tips of the first patient's demonstration are: what is worked on.
        scene = self._scenes[0]
        ends_s = scene.demonstration_ends_s or 0.0
        points_m: Floats = np.concatenate([scene.demonstration(share * ends_s)[: self.hands, :3] for share in (0.25, 0.5, 0.75)])
        return points_m

    def begin(self, random: np.random.Generator, variant: int) -> tuple[Floats, dict[str, Floats]]:
        hands = np.array(self._scenes[variant].demonstration(0.0)[: self.hands])
        hands[:, :3] += random.uniform(-ASIDE_M, ASIDE_M, (self.hands, 3))
        return hands[0] if self.hands == 1 else hands, {"variant": np.array(float(variant))}

    def _hands(self, episodes: Episodes) -> Floats:
        return episodes.hands.reshape(len(episodes.steps), self.hands, 9)

    def move(self, episodes: Episodes, actions: Floats) -> Floats:
        hands, wanted = self._hands(episodes).copy(), actions[:, self._of_pose]
        hands[:, :, :8] += _STRIDES * wanted[:, :, :8]
        length = np.linalg.norm(hands[:, :, 3:6], axis=2, keepdims=True)
        # A shaft without a direction stays as it was.
        hands[:, :, 3:6] = np.where(length > 1e-3, hands[:, :, 3:6] / np.maximum(length, 1e-3), self._hands(episodes)[:, :, 3:6])
        hands[:, :, 7] = np.clip(hands[:, :, 7], 0.0, 1.0)
        hands[:, :, 8] = wanted[:, :, 8] > 0.5
        return hands.reshape(episodes.hands.shape)

    def clips(self, actions: Floats) -> NDArray[np.bool_]:
        clips = np.zeros((len(actions), self.hands), dtype=bool)
        for hand, sets_clips in enumerate(self._is_clipping):
            if sets_clips:
                clips[:, hand] = actions[:, self._of_clip[hand]] > 0.5
        return clips

    def observe(self, episodes: Episodes, seen: Seen) -> Floats:
        n = len(episodes.steps)
        held = (seen.n_held[:, : self.hands, None] > 0).astype(np.float64)
        of_hands = np.concatenate([seen.poses[:, : self.hands], held, seen.forces_n[:, : self.hands]], axis=2)
        return np.column_stack(
            [
                of_hands.reshape(n, -1),
                seen.marks_m.reshape(n, -1),
                seen.share_done,
                seen.progress[:, 2],
                seen.progress[:, 3],
                episodes.steps / self.most_steps,
            ]
        )

    def remember(self, episodes: Episodes, seen: Seen, fresh: NDArray[np.bool_]) -> None:
        memory = episodes.memory
        remember_steps(memory, fresh, done=seen.share_done, mistakes=seen.progress[:, 3], blood_ml=ML_PER_M3 * seen.blood_lost_m3)
        time_s = memory.setdefault("time_s", np.zeros(len(fresh)))
        arrived = self._is_there(episodes, time_s)
        time_s[:] = np.where(fresh, 0.0, time_s + np.where(arrived, 1.0 / self.control_rate_hz, 0.0))

    def terms(self, episodes: Episodes, seen: Seen, actions: Floats) -> tuple[dict[str, Floats], NDArray[np.bool_], NDArray[np.bool_]]:
        done, memory = seen.is_done, episodes.memory
        force_n = np.linalg.norm(seen.forces_n[:, : self.hands], axis=2).max(axis=1)
        terms = {
            "progress": memory["done_step"],
            "mistake": memory["mistakes_step"],
            "blood": memory["blood_ml_step"],
            "force": np.maximum(0.0, force_n - FORCE_THRESHOLD_N),
            "success": done.astype(np.float64),
        }
        return terms, done, done

    def _led(self, episodes: Episodes, time_s: Floats) -> Floats:
        """Where the demonstration has the hands, (n, hands, 9)."""
        variants = episodes.goals["variant"].astype(int)
        return np.stack([self._scenes[variant].demonstration(at_s)[: self.hands] for variant, at_s in zip(variants, time_s)])

    def _is_there(self, episodes: Episodes, time_s: Floats) -> NDArray[np.bool_]:
        off = np.abs(self._led(episodes, time_s) - self._hands(episodes))
        there: NDArray[np.bool_] = (off[:, :, :3].max(axis=(1, 2)) < NEAR_M) & (off[:, :, 3:8].max(axis=(1, 2)) < NEAR_RAD)
        return there

    def scripted(self, episodes: Episodes, seen: Seen) -> Floats:
        """Along the demonstration, at each of its moments as long as the hands need to get there."""
        time_s = episodes.memory["time_s"]
        led = self._led(episodes, time_s)
        off = led - self._hands(episodes)
        actions = np.full((len(time_s), len(self.action_names)), -1.0)
        actions[:, self._of_pose[:, :8]] = off[:, :, :8] / _STRIDES
        actions[:, self._of_pose[:, 8]] = np.where(led[:, :, 8] > 0.5, 1.0, -1.0)
        for variant, (episode, at_s) in zip(episodes.goals["variant"].astype(int), enumerate(time_s)):
            for hand in self._scenes[variant].demonstrated_clips(at_s - 1.0 / self.control_rate_hz, at_s):
                # It is set once it is there.
                will_be = np.abs(actions[episode, self._of_pose[:, :8]]).max() <= 1.0
                if will_be and hand < self.hands and self._is_clipping[hand]:
                    actions[episode, self._of_clip[hand]] = 1.0
        return actions
