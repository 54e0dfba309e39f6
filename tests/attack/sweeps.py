"""A sweep that is killed at any time, or meets another of its name: the archive is complete or unchanged.

After a kill the next call goes on. Of two at once one is done, and the other is done after it or refused.
"""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import mbdlft
from mbdlft.batch import staging
from tests.archive import models

ROOT = Path(__file__).parents[2]
_COUNT, _SHARD = 30_000, 4096
_KEYS = ("samples", "A", "B", "C", "D", "trim", "residual", "status")
SWEEP = """
import sys
import mbdlft
from mbdlft.batch import staging

staging._SHARD_ROWS = int(sys.argv[3])
model = mbdlft.load(sys.argv[1], "two_link_arm")
print("ready", flush=True)
options = {"poles": True, "float32": sys.argv[5] == "1", "workers": int(sys.argv[4])}
mbdlft.sweep(model, mbdlft.RandomSamples(int(sys.argv[2]), 3), sys.argv[1], name="s", **options)
"""


def attack(seed: int, folder: Path) -> str:
    """Kill a sweep after a random time, change what is there now and then, and sweep again."""
    random = np.random.default_rng(seed)
    if seed % 4 == 3:
        return two_at_once(random, folder)
    file, workers = folder / "a.h5", int(random.integers(1, 3))
    single = bool(random.integers(2))
    mbdlft.save(file, models.arm())
    before = file.read_bytes()
    arguments = [str(file), str(_COUNT), str(_SHARD), str(workers), str(int(single))]
    with subprocess.Popen(
        [sys.executable, "-c", SWEEP, *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        notes = folder / ".a.h5.s.sweep"
        early = random.random() < 0.2
        while not early and process.poll() is None and not list(notes.glob("shard-*")):
            time.sleep(0.002)
        time.sleep(float(random.uniform(0.0, 0.15)))
        with contextlib.suppress(ProcessLookupError):  # it may have ended
            os.killpg(process.pid, signal.SIGKILL)
    done = "s" in mbdlft.sweep_names(file)
    assert done or file.read_bytes() == before
    rows = folder / ".a.h5.s.sweep" / "rows.h5"
    damaged = rows.exists() and random.random() < 0.5
    if damaged:
        image = bytearray(rows.read_bytes())
        for _ in range(3):
            image[int(random.integers(len(image)))] ^= 1 << int(random.integers(8))
        rows.write_bytes(image)
    resumed = swept(file, single=single)
    check(folder, single=single)
    how = "complete" if done else "resumed" if resumed else "begun again"
    return how + " after damage" * damaged


def two_at_once(random: np.random.Generator, folder: Path) -> str:
    """Two sweeps of one name, the second a little later."""
    file = folder / "a.h5"
    mbdlft.save(file, models.arm())
    both = []
    for _ in range(2):
        arguments = [str(file), str(_COUNT), str(_SHARD), "1", "0"]
        pipes: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
        both.append(subprocess.Popen([sys.executable, "-c", SWEEP, *arguments], cwd=ROOT, **pipes))
        time.sleep(float(random.uniform(0.0, 0.3)))
    refused = 0
    for process in both:
        why = process.communicate()[1]
        if process.returncode:
            refused += 1
            assert re.search(r"ArchiveError: .* process \d+ computes this sweep now", why), why
    assert refused < 2
    check(folder, single=False)
    return "one after the other" if not refused else "one of two"


def swept(file: Path, *, single: bool) -> bool:
    """The same sweep in this process; whether it went on with another one."""
    kept = staging._SHARD_ROWS
    staging._SHARD_ROWS = _SHARD
    options = {"poles": True, "float32": single, "workers": 1, "name": "s"}
    try:
        return mbdlft.sweep(models.arm(), mbdlft.RandomSamples(_COUNT, 3), file, **options).resumed  # type: ignore[arg-type]
    finally:
        staging._SHARD_ROWS = kept


def check(folder: Path, *, single: bool) -> None:
    """The archive has the sweep that an archive beside it gets, and nothing is left of the way."""
    file = folder / "a.h5"
    swept(folder / "b.h5", single=single)
    one, two = mbdlft.load_sweep(file, "s"), mbdlft.load_sweep(folder / "b.h5", "s")
    for key in (*_KEYS, "poles"):
        assert np.array_equal(getattr(one, key), getattr(two, key)), key
    models.same(mbdlft.load(file, "two_link_arm"), models.arm())
    assert sorted(path.name for path in folder.iterdir()) == ["a.h5", "b.h5"]
