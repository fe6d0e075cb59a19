"""The page before a world that Python steps::

    from glisson import viewer

    with glisson.World(scene) as world, viewer.launch_passive(world) as page:
        poses = world.poses.copy()
        while page.is_running():
            if page.is_paused:
                time.sleep(0.01)
            else:
                world.step(10, page.poses(poses))   # what is moved in the page is where it was moved
            page.sync()

It shows what the served page shows. Instruments that are moved there, pauses, single steps and going back to rest are told to Python, which
does them or not. Who has ``teacher_address`` draws on the tissue.
"""

from __future__ import annotations

import os
import sys
import webbrowser

from glisson._glisson import Viewer, World

__all__ = ["Viewer", "launch_passive"]


def launch_passive(
    world: World,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    token: str | None = None,
    open_browser: bool | None = None,
) -> Viewer:
    """Serves the page of ``world`` at a free port, tells where, and opens a browser where there is a display.

    ``host`` that is not this machine's own lets in who has the ``token``, a random one if none is given; no browser is opened then. Call
    ``sync`` after steps, on the thread that steps; the page is served by another one until ``close``, or the end of a ``with``.

    Raises SimulationError where the port is taken.
    """
    viewer = Viewer(world, host, port, token)
    print(f"Glisson is at {viewer.address}", file=sys.stderr)
    is_own = host in ("127.0.0.1", "localhost", "::1")
    has_display = sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if open_browser if open_browser is not None else is_own and has_display:
        webbrowser.open(viewer.address)
    return viewer
