"""A metastasis is cut out of a patient's liver with a margin around it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from glisson import Scene
from glisson.envs.task_file import TaskFile


class LiverResection(TaskFile):
    """Cut a wedge out around the metastasis with the scalpel, take it between the grasper's jaws, and take it away: the task
    ``metastasectomy``.

    ``tetrahedra``: how many the liver has, about; ``patients``: seeds of the synthetic patients, of which each episode has one (26, 4, 20,
    24, 32 are tried). The actions move both instruments, see :class:`TaskFile`.
    """

    def __init__(self, *, tetrahedra: int = 2000, patients: Sequence[int] = (26,), level: str | None = None, **options: Any) -> None:
        self.tetrahedra = tetrahedra
        super().__init__(task="metastasectomy", level=level, patients=patients, **options)

    def _scene(self, task: Any, level: str | None, patient: int | None) -> Scene:
        scene = super()._scene(task, level, patient)
        text, n_changed = re.subn(r"tetrahedra = \d+", f"tetrahedra = {int(self.tetrahedra)}", scene.text)
        if n_changed != 1:
            raise RuntimeError(f"the task {task} says {n_changed} times how many tetrahedra its liver has")
        return Scene.parse(text, scene.folder)
