"""Programs in archives, changed with a right digest: refused, or the values are those of the matrices."""

from pathlib import Path
from typing import Any

import numpy as np

import mbdlft
from mbdlft import ArchiveError
from mbdlft.lft.sampling import values_and_sizes
from mbdlft.system.sampled import deltas_of
from tests.archive import models
from tests.archive.plain_digest import edit
from tests.archive.test_program import with_bump
from tests.close import roundoff

_COUNT = 1100
_NAMES = ("operation", "left", "right", "numbers", "result", "pivots")


def attack(seed: int, folder: Path) -> str:
    """Change some entries of a program; load it, and evaluate many samples."""
    random = np.random.default_rng(seed)
    file, model = folder / "a.h5", models.carried()
    if seed % 3 == 2:
        return false_in_a_part(random, file, model)
    mbdlft.save(file, model)

    def change(group: Any) -> None:
        for _ in range(int(random.integers(1, 4))):
            item = group[f"program/{_NAMES[int(random.integers(len(_NAMES)))]}"]
            values = item[()]
            at = tuple(int(random.integers(size)) for size in values.shape)
            if values.dtype.kind == "f":
                values[at] = float(random.choice([0.0, -1.0, 1e308, 5e-324, np.nan, values[at] * 2]))
            else:
                some = [0, -1, 1, values[at] + 1, values[at] - 1, int(random.integers(-20, 200))]
                values[at] = int(random.choice(some)) % 127
            item[...] = values

    edit(file, change, "models/carried")
    try:
        found = mbdlft.load(file)
    except ArchiveError:
        return "refused"
    if found.program is None:
        return "left out"
    values = mbdlft.random(model.parameters, _COUNT, seed)
    A, B, C, D = mbdlft.matrices_at(found, values)
    expected, _ = values_and_sizes(model.lft, deltas_of(model, values))
    roundoff(np.block([[A, B], [C, D]]), expected, kappa=1e3)
    same = found.program.program == model.program.program  # type: ignore[union-attr]
    return "not changed" if same else "evaluated"


def false_in_a_part(random: np.random.Generator, file: Path, model: mbdlft.LFTModel) -> str:
    """A program with another value in half a percent to two of the box, which few samples see."""
    count, share = int(random.integers(1, 5)), float(random.uniform(0.005, 0.02))
    places = random.choice(len(model.parameters), count, replace=False).tolist()
    middles = dict(zip(places, random.uniform(0.2, 0.8, count), strict=True))
    mbdlft.save(file, with_bump(model, middles, share, smooth=bool(random.integers(2))))
    assert mbdlft.load(file).program is None, "a false program is used"
    return "false in a part, left out"
