"""A writer that is killed at any time: the file is complete or unchanged, and the next writer goes on."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import mbdlft
from tests.archive import models

ROOT = Path(__file__).parents[2]
WRITER = """
import sys
from mbdlft import load, save

model = load(sys.argv[1], "kept")
print("ready", flush=True)
k = 0
while True:
    save(sys.argv[1], model, f"n{k % 5}")
    k += 1
"""


def attack(seed: int, folder: Path) -> str:
    """Kill a process that writes again and again; read what is there, and write."""
    random = np.random.default_rng(seed)
    file, model = folder / "a.h5", models.strange(4)
    mbdlft.save(file, model, "kept")
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(file)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(float(random.uniform(0.0, 0.2)))
        process.send_signal(signal.SIGKILL)
    left = len(list(folder.iterdir())) - 1
    names = mbdlft.model_names(file)
    for name in names:
        found = mbdlft.load(file, name)
        models.same(found, _named(model, name))
    mbdlft.save(file, model, "after")
    assert mbdlft.model_names(file) == tuple(sorted({*names, "after"}))
    assert list(folder.iterdir()) == [file]
    return "killed while writing" if left else "killed between"


def _named(model: mbdlft.LFTModel, name: str) -> mbdlft.LFTModel:
    from dataclasses import replace

    return replace(model, name=name)
