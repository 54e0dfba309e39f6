"""Two writers of one file at the same time: none loses what the other has written."""

import subprocess
import sys
from pathlib import Path

import numpy as np

import mbdlft
from tests.archive import models

ROOT = Path(__file__).parents[2]
WRITER = """
import sys
from mbdlft import load, save

source, file, prefix, count = sys.argv[1:]
model = load(source)
print("ready", flush=True)
sys.stdin.readline()
for k in range(int(count)):
    save(file, model, f"{prefix}{k}")
"""


def attack(seed: int, folder: Path) -> str:
    """Let two processes write a few models each; all are there."""
    random = np.random.default_rng(seed)
    file, count = folder / "a.h5", int(random.integers(2, 8))
    mbdlft.save(folder / "source.h5", models.bare())
    writers = [
        subprocess.Popen(
            [sys.executable, "-c", WRITER, str(folder / "source.h5"), str(file), prefix, str(count)],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for prefix in ("x", "y")
    ]
    for writer in writers:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "ready\n"
    for writer in writers:
        assert writer.stdin is not None
        writer.stdin.write("go\n")
        writer.stdin.flush()
    for writer in writers:
        writer.communicate(timeout=60)
        assert writer.returncode == 0
    wanted = tuple(sorted(f"{prefix}{k}" for prefix in "xy" for k in range(count)))
    assert mbdlft.model_names(file) == wanted
    assert sorted(path.name for path in folder.iterdir()) == ["a.h5", "source.h5"]
    return "pairs that lost nothing"
