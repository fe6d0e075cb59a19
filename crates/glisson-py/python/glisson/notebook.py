"""Notebooks (Jupyter and others): a recorded session that plays in its cell.

A world at the end of a cell is a picture, a viewer its page.
"""

from __future__ import annotations

import html
import os

from glisson._glisson import _replay_page

__all__ = ["Player", "player"]


class Player:
    """A page that plays a session, in a frame of a notebook."""

    def __init__(self, page: str, height: int) -> None:
        self.page = page
        self.height = height

    def _repr_html_(self) -> str:
        # In a frame of its own: its scripts see nothing of the notebook.
        return (
            f'<iframe srcdoc="{html.escape(self.page)}" sandbox="allow-scripts allow-downloads" '
            f'width="100%" height="{self.height}" style="border: 0"></iframe>'
        )


def player(session: str | os.PathLike[str], folder: str | os.PathLike[str] | None = None, *, height: int = 600) -> Player:
    """A recorded session to play in a notebook; the scene's files are in ``folder``, the session's own unless given.

    Raises SimulationError where the replay does not make the bits of the recording.
    """
    return Player(_replay_page(session, folder), height)
