"""Damaged archives: what is read is what was written, or it is an ArchiveError; nothing is lost."""

from functools import cache
from pathlib import Path

import h5py
import numpy as np

import mbdlft
from mbdlft import ArchiveError, RandomSamples
from mbdlft.archive import reading
from tests.archive import models
from tests.archive.test_systems import mixed, same_system
from tests.attack.mutations import damaged

HERE = Path(__file__).parents[1] / "archive"


@cache
def whole() -> bytes:
    """An archive with three models, one with a straight-line program, a system and a sweep."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "a.h5"
        mbdlft.save(file, models.strange(4), "strange")
        mbdlft.save(file, mixed())
        mbdlft.save(file, models.carried())
        mbdlft.sweep(models.strange(1, (1,)), RandomSamples(20), file, name="rows", workers=1)
        return file.read_bytes()


def attack(seed: int, folder: Path) -> str:
    """Damage an archive of 1.1 (or the one of 1.0), read it, and write into it."""
    random = np.random.default_rng(seed)
    old = seed % 4 == 3
    source = (HERE / "archive_1_0.h5").read_bytes() if old else whole()
    data = damaged(source, random) if random.random() < 0.8 else _objects(source, folder, random)
    if random.random() < 0.2:
        data = reading.sealed(data)  # as if it had been damaged before it was sealed
    file = folder / "a.h5"
    file.write_bytes(data)
    read = 0
    for name, wanted in _expected(old):
        try:
            found = mbdlft.load(file, name)
        except ArchiveError:
            continue
        read += 1
        if wanted is not None:
            same_system(found, wanted) if name == "mixed" else models.same(found, wanted)
    try:
        mbdlft.load_sweep(file)
        read += 1
    except ArchiveError:
        pass
    before = _names(file)
    try:
        mbdlft.save(file, models.bare(), "new")
    except ArchiveError:
        assert file.read_bytes() == data, "a write that failed has changed the file"
    else:
        assert before is not None, "models that cannot be listed were dropped"
        assert set(mbdlft.model_names(file)) == before | {"new"}
    return "refused" if read == 0 else "read in part or whole"


def _names(file: Path) -> set[str] | None:
    try:
        return set(mbdlft.model_names(file))
    except ArchiveError:
        return None


def _expected(old: bool) -> list[tuple[str, object]]:
    """Names with the models that must be read if anything is; 1.0 cannot know all of its damage."""
    if old:
        return [("turned_arm", None), ("numbers", None)]
    from dataclasses import replace

    strange = replace(models.strange(4), name="strange")
    return [("strange", strange), ("mixed", mixed()), ("carried", models.carried())]


def _objects(source: bytes, folder: Path, random: np.random.Generator) -> bytes:
    """An archive changed with the library: items gone, of other shapes and types, linked elsewhere."""
    file = folder / "b.h5"
    file.write_bytes(source)
    with h5py.File(file, "r+") as archive:
        paths: list[str] = []
        archive.visit(paths.append)
        for _ in range(int(random.integers(1, 4))):
            path = paths[int(random.integers(len(paths)))]
            try:
                parent, name = archive[path].parent, path.rpartition("/")[2]
            except KeyError:  # it has gone, or leads elsewhere
                continue
            kind = random.integers(7)
            if kind == 6 or isinstance(archive[path], h5py.Group):
                key = ("digest", "encoding_version", "more")[int(random.integers(3))]
                archive[path].attrs[key] = random.bytes(3).hex()
                continue
            del parent[name]
            match kind:
                case 0:
                    pass
                case 1:
                    parent[name] = h5py.SoftLink("/models")
                case 2:
                    parent[name] = h5py.ExternalLink("/etc/hostname", "/")
                case 3:
                    parent.create_dataset(name, (10**7, 10**7), "<f8", chunks=(100, 100))
                case 4:
                    parent[name] = random.standard_normal(tuple(random.integers(0, 4, 2)))
                case _:
                    parent[name] = archive["models"]
    return file.read_bytes()
