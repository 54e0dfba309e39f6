"""Every error of sweeps, by class and message."""

from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import AnalysisError, ArchiveError, GridSamples, Parameter, RandomSamples, SceneError
from mbdlft.archive import sweep as sweeps
from mbdlft.batch import staging
from tests.errors.scenes import cart
from tests.errors.table import refused, says


def scene() -> mbdlft.Scene:
    return cart("m", [Parameter("m", 1.0, low=0.5, high=2.0, unit="kg")])


@pytest.mark.parametrize(
    ("samples", "texts"),
    [
        ({"M": 1.0}, ("sweep, samples: unknown parameter 'M'", "m")),
        (GridSamples({"M": 2}), ("sweep, grid: unknown parameter 'M'", "m")),
        (GridSamples({"m": 0}), ("number of values of at least 1", "{'m': 0}")),
        (GridSamples({}), ("number of values of at least 1", "{}")),
        (RandomSamples(0), ("at least 1 random sample", "count=0")),
        (RandomSamples(1, -1), ("a seed of at least 0", "seed=-1")),
        ([1.0], ("expected GridSamples, RandomSamples or a mapping", "got list")),
        ({"m": [[1.0]]}, ("numbers or arrays of one length, got shapes [(1, 1)]",)),
        ({"m": []}, ("there are no samples",)),
        ({"m": [1.0, 3.0]}, ("sample 1: m = 3 is outside its range [0.5, 2] kg", "Widen")),
        ({"m": [1.0, np.nan]}, ("sample 1: m = nan is outside its range",)),
    ],
)
def test_samples(tmp_path: Path, samples: object, texts: tuple[str, ...]) -> None:
    with says(AnalysisError, *texts):
        mbdlft.sweep(scene(), samples, tmp_path / "a.h5", workers=1)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


test_messages = refused(
    r"""
> {} => AnalysisError:
mbdlft.sweep(cart('m', [Parameter('k', 1.0, percent=5), Parameter('m', 1.0, percent=50)]), {'m': [1.0,
    1.1], 'k': [1.0] * 3}, tmp_path / 'a.h5')
    => numbers or arrays of one length, got shapes [(2,), (3,)]
mbdlft.sweep("scene.toml", {}, tmp_path / "a.h5")
    => SceneError: sweep: expected a Scene or an LFTModel, got str
mbdlft.sweep(scene(), {}, tmp_path / "a.h5", workers=0) => sweep: expected at least 1 worker, got 0
"""
)


def test_archive_that_cannot_be_written(tmp_path: Path) -> None:
    with says(ArchiveError, "'a/b' cannot name a sweep"):
        mbdlft.sweep(scene(), {}, tmp_path / "a.h5", name="a/b")
    with says(ArchiveError, "cannot be written", "is not a folder"):
        mbdlft.sweep(scene(), {}, tmp_path / "no" / "a.h5")
    (tmp_path / "a.h5").write_text("no archive", encoding="utf-8")
    with says(ArchiveError, "is not a whole HDF5 file"):
        mbdlft.sweep(scene(), {}, tmp_path / "a.h5")
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_shard_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(staging.os, "fsync", full)
    with says(ArchiveError, "cannot be written: No space left on device. What is finished stays"):
        mbdlft.sweep(scene(), {}, tmp_path / "a.h5", workers=1)
    monkeypatch.undo()
    monkeypatch.setattr(sweeps.os, "posix_fallocate", full, raising=False)
    with says(ArchiveError, "cannot be written: No space left on device. What is finished stays"):
        mbdlft.sweep(scene(), {}, tmp_path / "a.h5", workers=1)
    monkeypatch.undo()
    monkeypatch.setattr(sweeps, "_put", full)
    with says(ArchiveError, "cannot be written: No space left on device. What is finished stays"):
        mbdlft.sweep(scene(), {}, tmp_path / "a.h5", workers=1)
    monkeypatch.undo()
    mbdlft.sweep(scene(), {}, tmp_path / "a.h5", workers=1)
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_error_of_a_worker_is_that_of_the_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A scene that the workers cannot assemble, though this process could."""
    monkeypatch.setattr(staging, "_SHARD_ROWS", 1)
    monkeypatch.setattr(staging, "scene_to_toml", lambda _: "name = 3")
    with says(SceneError, "the line format = 'mbdlft-scene/1' is missing"):
        mbdlft.sweep(scene(), RandomSamples(10_000), tmp_path / "a.h5", workers=2)


def test_sample_files(tmp_path: Path) -> None:
    file = tmp_path / "s.csv"
    with says(AnalysisError, f"{file}: cannot be read"):
        mbdlft.read_samples(file)
    file.write_text("m,k\n1.0,2.0\n3.0,x\n", encoding="utf-8")
    with says(AnalysisError, f"{file}: expected names in the first line"):
        mbdlft.read_samples(file)
    for text in ("m,m\n1.0,2.0\n", "m\n1.0,2.0\n"):
        file.write_text(text, encoding="utf-8")
        with says(AnalysisError, f"{file}: expected as many different names as columns"):
            mbdlft.read_samples(file)
