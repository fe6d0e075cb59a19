"""Smoothness of motions by our program and by monalysa.

metrics.py PACKAGES PROGRAM FOLDER: monalysa and numpy are in PACKAGES, PROGRAM is the example `smoothness`, files go to FOLDER.
"""

import importlib.util
import os
import subprocess
import sys

packages, program, folder = sys.argv[1:]
sys.path.insert(0, packages)

import numpy as np  # noqa: E402

# By its file: the package itself needs more than this module does.
place = os.path.join(packages, "monalysa", "quality", "smoothness.py")
spec = importlib.util.spec_from_file_location("smoothness", place)
monalysa = importlib.util.module_from_spec(spec)
spec.loader.exec_module(monalysa)

ALLOWED = 1e-9
random = np.random.default_rng(7)


def motions():
    """Name, speeds [m/s] and rate [Hz]."""
    t = np.arange(-1, 1, 0.01)
    yield "the source's example", np.exp(-5 * t**2), 100.0
    s = np.linspace(0, 1, 151)
    yield "least jerk", 30 * s**2 * (1 - s) ** 2, 100.0
    yield "stop and go", np.abs(np.sin(3 * np.pi * s)) * s, 50.0
    for n in range(40):
        rate = float(random.choice([50, 100, 125, 1000]))
        n_samples = int(random.integers(40, 1500))
        s = np.linspace(0, 1, n_samples)
        waves = sum(random.normal() / k * np.sin(np.pi * k * s) for k in range(1, int(random.integers(2, 20))))
        yield f"random {n}", 0.1 * np.abs(waves + random.normal(scale=0.01, size=n_samples)), rate


def said_by_ours(speeds, rate):
    file = os.path.join(folder, "speeds.txt")
    np.savetxt(file, speeds, fmt="%.17g")
    lines = subprocess.run([program, file, repr(rate)], check=True, capture_output=True, text=True).stdout
    return [float(line.split(": ")[1]) for line in lines.splitlines()]


greatest, n_compared = 0.0, 0
for name, speeds, rate in motions():
    theirs = [monalysa.sparc(speeds, rate)[0], monalysa.log_dimensionless_jerk(speeds, rate, "vel")]
    ours = said_by_ours(speeds, rate)
    for metric, a, b in zip(["SPARC", "LDLJ"], ours, theirs):
        off = abs(a - b)
        greatest, n_compared = max(greatest, off), n_compared + 1
        if not off <= ALLOWED:
            sys.exit(f"{name}: {metric} is {a} by glisson and {b} by monalysa; allowed difference {ALLOWED}")
print(f"smoothness: {n_compared} values as monalysa has them, greatest difference {greatest:.1e}")
