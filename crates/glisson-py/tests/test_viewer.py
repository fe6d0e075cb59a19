"""The page before a world that Python steps, and what notebooks show."""

import base64
import json
import os
import socket
import struct
import time
import urllib.error
import urllib.request

import numpy as np
import pytest

import glisson
from conftest import pressed
from glisson import notebook, viewer


class Page:
    """As much of a browser as a viewer needs: a WebSocket that sends texts, and reads what comes."""

    def __init__(self, address):
        host, _, port = address.removeprefix("http://").rstrip("/").partition(":")
        self.socket = socket.create_connection((host, int(port)), timeout=20)
        key = base64.b64encode(os.urandom(16)).decode()
        ask = f"GET /ws HTTP/1.1\r\nHost: {host}:{port}\r\nOrigin: http://{host}:{port}\r\nUpgrade: websocket\r\n"
        self.socket.sendall((ask + f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n").encode())
        self.stream = self.socket.makefile("rb")
        assert b"101" in self.stream.readline()
        while self.stream.readline().strip():
            pass

    def _frame(self, kind, payload):
        mask = os.urandom(4)
        length = bytes([0x80 | len(payload)]) if len(payload) < 126 else bytes([0x80 | 126]) + struct.pack(">H", len(payload))
        masked = bytes(b ^ mask[i % 4] for i, b in enumerate(payload))
        self.socket.sendall(bytes([0x80 | kind]) + length + mask + masked)

    def send(self, **message):
        self._frame(1, json.dumps(message).encode())

    def read(self):
        """The next text; pictures are passed over, pings answered."""
        while True:
            kind, length = self.stream.read(2)
            length &= 127
            if length >= 126:
                length = struct.unpack(">H" if length == 126 else ">Q", self.stream.read(2 if length == 126 else 8))[0]
            payload = self.stream.read(length)
            if kind & 15 == 9:
                self._frame(10, payload)
            elif kind & 15 == 1:
                return json.loads(payload)

    def close(self):
        self.socket.shutdown(socket.SHUT_RDWR)
        self.stream.close()
        self.socket.close()


def look(page, what):
    with urllib.request.urlopen(f"{page.address}api/{what}", timeout=20) as answer:
        return json.load(answer)


def until(page, holds):
    """Syncs until something holds."""
    end = time.monotonic() + 20
    while not holds():
        assert time.monotonic() < end, "it did not come"
        page.sync()
        time.sleep(0.005)


def test_a_page_sees_the_world_that_python_steps_and_python_what_it_asks(scene):
    world = glisson.World(scene)
    with viewer.launch_passive(world, open_browser=False) as page:
        assert page.is_running() and page.watchers == 0 and look(page, "scene")["tools"][0]["name"] == "probe"
        browser = Page(page.address)
        until(page, lambda: page.watchers == 1)
        world.step(50, pressed(world))
        until(page, lambda: look(page, "snapshot")["step"] == 50)
        before = world.hash()

        assert page.in_hand == [] and not page.is_paused
        pose = [0.01, -0.03, 0.002]
        browser.send(type="tool", tool=0, tip_m=pose, shaft=[0, -1, 0])
        until(page, lambda: page.in_hand == [0])
        asked = page.poses(world.poses)
        assert np.allclose(asked[0, :3], pose) and world.hash() == before, "the page asks, Python does"
        browser.send(type="single_step")
        until(page, lambda: page.n_steps == 1)
        assert page.is_paused
        browser.send(type="undo")
        until(page, lambda: any("another program steps" in notice for notice in world.notices))
        page.let_go(0)
        assert page.in_hand == [] and np.allclose(page.poses(world.poses), world.poses)
        browser.send(type="reset")
        until(page, lambda: page.n_resets == 1)

        # Another cut after coming back has another surface of the same version.
        saved = world.save()
        versions = []
        for cut in ([0], [len(world.tetrahedra) - 1]):
            world.remove(cut)
            until(page, lambda: look(page, "snapshot")["topology_version"] not in versions)
            versions.append(look(page, "snapshot")["topology_version"])
            world.restore(saved)
        assert versions[1] > versions[0]

        # A world that goes back is shown as it is then.
        world.reset()
        until(page, lambda: look(page, "snapshot")["step"] == world.steps)
        browser.close()
        until(page, lambda: page.watchers == 0)
        assert page.is_running(), "a page that is loaded again comes back"
        assert page.address in page._repr_html_()
    assert not page.is_running()
    with pytest.raises(glisson.SimulationError, match="closed"):
        page.sync()
    with pytest.raises(urllib.error.URLError):
        look(page, "scene")
    page.close()


def test_worlds_that_are_watched_have_the_bits_of_others(scene):
    alone, watched = glisson.World(scene), glisson.World(scene)
    with viewer.launch_passive(watched, open_browser=False) as page:
        browser = Page(page.address)
        for _ in range(20):
            for world in (alone, watched):
                world.step(5, pressed(world))
            page.sync()
        browser.close()
    assert alone.hash() == watched.hash()


def test_a_taken_port_is_told(scene):
    world = glisson.World(scene)
    with viewer.launch_passive(world, open_browser=False) as page:
        port = int(page.address.rstrip("/").rpartition(":")[2])
        with pytest.raises(glisson.SimulationError, match=str(port)):
            viewer.launch_passive(world, port=port, open_browser=False)
    world.close()
    with pytest.raises(glisson.SimulationError, match="closed"):
        viewer.launch_passive(world, open_browser=False)


def test_who_has_no_token_sees_nothing(scene):
    with viewer.launch_passive(glisson.World(scene), host="0.0.0.0", token="0123456789abcdef") as page:
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(page.address.split("?")[0] + "api/scene", timeout=20)
        assert "0123456789abcdef" in page.address


def test_a_world_is_a_picture_in_a_notebook(scene):
    png = glisson.World(scene)._repr_png_()
    assert png[:8] == b"\x89PNG\r\n\x1a\n" and struct.unpack(">II", png[16:24]) == (640, 480)


def test_a_session_plays_in_a_notebook(tmp_path, scene):
    with glisson.World(scene, record=tmp_path / "press.jsonl") as world:
        world.step(60, pressed(world))
    try:
        shown = notebook.player(tmp_path / "press.jsonl", height=400)
    except glisson.SimulationError as error:
        if "without its pages" in str(error):
            pytest.skip("the program was built without its pages")
        raise
    frame = shown._repr_html_()
    assert frame.startswith("<iframe srcdoc=") and 'height="400"' in frame and "<script" not in frame
    assert len(shown.page) > 100_000
    with pytest.raises(glisson.SimulationError, match="nowhere"):
        notebook.player(tmp_path / "nowhere.jsonl")
