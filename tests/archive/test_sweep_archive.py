"""Sweeps in archives: layout, models beside them, atomic writes, large files."""

import os
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdlft
from mbdlft import RandomSamples
from mbdlft.archive import archive, hdf5, reading
from tests.archive import models
from tests.archive.models import contents, same
from tests.close import exact
from tests.errors.scenes import cart
from tests.errors.table import says


def swept(file: Path, count: int = 5000, name: str = "s") -> None:
    """Needs more than one chunk."""
    model = models.arm()
    mbdlft.sweep(model, RandomSamples(count), file, name=name, workers=1)


def test_layout_as_documented(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    swept(file)
    with h5py.File(file) as found:
        assert found.attrs["format"] == b"mbdlft-archive"
        assert found.attrs["format_version"] == b"1.1"
        group = found["sweeps/s"]
        assert group.attrs["encoding_type"] == b"sweep"
        assert group.attrs["encoding_version"] == b"1.1"
        assert group.attrs["model"] == b"two_link_arm"
        shapes = {"samples": (7,), "A": (4, 4), "B": (4, 2), "C": (2, 4), "D": (2, 2)}
        shapes |= {"trim/value": (2,), "residual": (), "status": ()}
        for key, shape in shapes.items():
            item = group[key]
            assert item.shape == (5000, *shape)
            assert item.dtype == ("i1" if key == "status" else "<f8")
            assert item.chunks[0] < 5000
            assert item.chunks[1:] == shape
        assert b"2: no equilibrium" in group["status"].attrs["meaning"]
        assert list(group["parameters/name"].asstr()) == [p.name for p in models.arm().parameters]
        for what in ("states", "inputs", "outputs", "trim", "parameters"):
            assert set(group[what]) >= {"name", "unit"}


def test_models_and_other_sweeps_stay(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    mbdlft.save(file, models.arm())
    before = contents(file)
    swept(file, name="first")
    swept(file, name="second")
    after = contents(file)
    assert {key: after[key] for key in before if key != "/"}.keys() == before.keys() - {"/"}
    same(mbdlft.load(file), models.arm())
    first = mbdlft.load_sweep(file, "first")
    swept(file, 7, name="second")
    assert mbdlft.sweep_names(file) == ("first", "second")
    assert len(mbdlft.load_sweep(file, "second").status) == 7
    exact(mbdlft.load_sweep(file, "first").A, first.A)
    mbdlft.save(file, models.strange(6), "other")
    exact(mbdlft.load_sweep(file, "first").A, first.A)
    exact(mbdlft.load_sweep(file, "first", 10, 20).A, first.A[10:20])
    assert mbdlft.model_names(file) == ("other", "two_link_arm")


def test_large_archives_are_not_held_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small, large = tmp_path / "a.h5", tmp_path / "b.h5"
    mbdlft.save(small, models.arm())
    swept(small)
    mbdlft.save(small, models.strange(6), "other")
    monkeypatch.setattr(archive, "LARGE", -1)
    monkeypatch.setattr(reading, "LARGE", -1)

    class Empty(BytesIO):
        def __init__(self, *held: bytes) -> None:
            assert not held, "an archive is held in memory"
            super().__init__()

    for module in (archive, hdf5):
        monkeypatch.setattr(module, "BytesIO", Empty)
    swept(large)
    mbdlft.save(large, models.arm())
    mbdlft.save(large, models.strange(6), "other")
    exact(mbdlft.load(large, "other").A, models.strange(6).A)
    monkeypatch.setattr(reading, "LARGE", 2**26)  # planted: it is
    large.write_bytes(reading.sealed(large.read_bytes()))
    with pytest.raises(AssertionError, match="held in memory"):
        mbdlft.load(large, "other")
    monkeypatch.undo()
    one, two = mbdlft.load_sweep(small), mbdlft.load_sweep(large)
    for name in ("samples", "A", "B", "C", "D", "trim", "residual", "status"):
        exact(getattr(two, name), getattr(one, name))


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_interrupted_writing_leaves_the_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    file = tmp_path / "a.h5"
    mbdlft.save(file, models.arm())
    before, called = file.read_bytes(), []
    original = archive.put

    def interrupt(*arguments: object, **options: object) -> None:
        called.append(step)
        raise KeyboardInterrupt

    def replace(images: dict[Path, bytes], made: Path | None = None) -> None:
        if file in images:
            monkeypatch.setattr(os, step, interrupt)
        original(images, made)

    monkeypatch.setattr(archive, "put", replace)
    with pytest.raises(KeyboardInterrupt):
        swept(file)
    monkeypatch.undo()
    assert called
    assert file.read_bytes() == before
    model = models.arm()
    assert mbdlft.sweep(model, RandomSamples(5000), file, name="s", workers=1).resumed == 5000
    same(mbdlft.load(file), model)
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_scene_without_parameters(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    mbdlft.sweep(cart(), {}, file, workers=1)
    found = mbdlft.load_sweep(file)
    assert found.samples.shape == (1, 0)
    assert found.A.shape == (1, 2, 2)
    assert found.status[0] == 0


def test_what_is_not_there_or_not_whole(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    mbdlft.save(file, models.arm())
    with h5py.File(file, "a") as found:
        found["sweeps"] = 1.0
    with says(mbdlft.ArchiveError, f"{file}: /sweeps is not a group"):
        mbdlft.sweep_names(file)
    with h5py.File(file, "a") as found:
        del found["sweeps"]
    with says(mbdlft.ArchiveError, f"{file}: give the name of the sweep. Existing: none."):
        mbdlft.load_sweep(file)
    swept(file)
    with says(mbdlft.ArchiveError, f"{file}: ", "unknown sweep", "'x'", "s"):
        mbdlft.load_sweep(file, "x")
    for change, text in (
        (lambda group: group.__delitem__("A"), "is not whole"),
        (lambda group: group.attrs.__setitem__("encoding_version", "2.0"), "this mbdlft reads up"),
        (lambda group: group.attrs.__setitem__("encoding_type", "x"), "encoding_type is 'x'"),
    ):
        swept(file)
        with h5py.File(file, "a") as found:
            change(found["sweeps/s"])
        with says(mbdlft.ArchiveError, "sweep 's'", text):
            mbdlft.load_sweep(file)
    swept(file)
    with h5py.File(file, "a") as found:
        del found["sweeps/s/D"]
        found["sweeps/s/D"] = np.zeros((4999, 2, 2))
    with says(
        mbdlft.ArchiveError, "sweep 's': the dataset 'D' has shape (4999, 2, 2), expected (5000, 2, 2)"
    ):
        mbdlft.load_sweep(file)
