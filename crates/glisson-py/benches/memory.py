"""Memory of an environment that is reset ten thousand times: a plot, and how much it grows.

    cargo xtask bench-python --memory TissueRetraction
"""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np

from glisson.envs import make_vec

#: Resets before what is held counts: threads and buffers are made in them.
WARM_UP = 500
#: Environments that are reset at once.
ENVS = 4


def resident_bytes() -> int:
    """Memory of this process that is in use."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def memory_over_resets(name: str, resets: int, steps: int = 2) -> np.ndarray:
    """Resets so far and memory in use [bytes] then, (readings, 2)."""
    envs = make_vec(name, ENVS)
    rng = np.random.default_rng(1)
    readings = []
    for n in range(0, resets, ENVS):
        envs.reset(seed=n)
        for _ in range(steps):
            envs.step(rng.uniform(-1.0, 1.0, envs.action_space.shape).astype(np.float32))
        if n % 100 < ENVS:
            readings.append((n, resident_bytes()))
    envs.close()
    return np.array(readings)


def growth_bytes(readings: np.ndarray) -> float:
    """By how much memory grows in all resets after the warm-up, along the line that fits best."""
    late = readings[readings[:, 0] >= WARM_UP]
    slope, _ = np.polyfit(late[:, 0], late[:, 1], 1)
    return float(slope * (late[-1, 0] - late[0, 0]))


def plot(readings: np.ndarray, title: str) -> str:
    """An SVG of memory over resets."""
    width, height, left, low = 640, 300, 60, 260
    most = 1.2 * readings[:, 1].max()
    x = left + (width - left - 20) * readings[:, 0] / readings[-1, 0]
    y = low - (low - 30) * readings[:, 1] / most
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y))
    words = [
        (left, 18, title),
        (4, low, "0 MB"),
        (4, int(y[-1]) + 4, f"{readings[-1, 1] / 1e6:.0f} MB"),
        (left, height - 14, f"resets: 0 to {readings[-1, 0]}"),
    ]
    texts = "".join(f'<text x="{a}" y="{b}">{text}</text>' for a, b, text in words)
    axes = f'<path d="M{left} 30V{low}H{width - 20}" fill="none" stroke="#888"/>'
    line = f'<polyline points="{points}" fill="none" stroke="#1f77b4" stroke-width="1.5"/>'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif" font-size="12">'
    return f'{head}<rect width="100%" height="100%" fill="#fff"/>{axes}{line}{texts}</svg>\n'


def measure(name: str, resets: int, out: Path) -> None:
    """Measures one environment, and writes its plot."""
    begun_s = time.monotonic()
    readings = memory_over_resets(name, resets)
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"memory_{name}.svg"
    file.write_text(plot(readings, f"{name}: memory in use"), encoding="utf-8")
    grown = growth_bytes(readings)
    took_s = time.monotonic() - begun_s
    print(f"{name}: {resets} resets in {took_s:.0f} s, {readings[-1, 1] / 1e6:.0f} MB, grown by {grown / 1e6:.2f} MB; {file}")
