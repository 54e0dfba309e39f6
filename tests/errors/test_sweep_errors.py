"""Every error of sweeps, by class and message."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import ArchiveError, Parameter, RandomSamples, SceneError
from mbdlft.archive import sweep as sweeps
from mbdlft.batch import staging
from tests.errors.scenes import cart
from tests.errors.table import refused, says


def scene() -> mbdlft.Scene:
    return cart("m", [Parameter("m", 1.0, low=0.5, high=2.0, unit="kg")])


@pytest.fixture
def swept(tmp_path: Path) -> Callable[[object], None]:
    """A sweep that is refused and writes nothing."""

    def sweep(samples: object) -> None:
        try:
            mbdlft.sweep(scene(), samples, tmp_path / "a.h5", workers=1)  # type: ignore[arg-type]
        finally:
            assert not list(tmp_path.iterdir())

    return sweep


@pytest.fixture
def file_of(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        (tmp_path / "s.csv").write_text(text, encoding="utf-8")
        return tmp_path / "s.csv"

    return write


test_messages = refused(
    r"""
> {} => AnalysisError:
mbdlft.sweep(cart('m', [Parameter('k', 1.0, percent=5), Parameter('m', 1.0, percent=50)]), {'m': [1.0,
    1.1], 'k': [1.0] * 3}, tmp_path / 'a.h5')
    => numbers or arrays of one length, got shapes [(2,), (3,)]
> mbdlft.sweep(scene(), dict(), {}) => ArchiveError:
tmp_path / "a.h5", workers=0 => AnalysisError: sweep: expected at least 1 worker, got 0
tmp_path / "a.h5", name="a/b" => 'a/b' cannot name a sweep
tmp_path / "no" / "a.h5" => cannot be written … is not a folder
file_of("no archive") => is not a whole HDF5 file
> swept({}) => AnalysisError:
{"M": 1.0} => sweep, samples: unknown parameter 'M' … m
GridSamples({"M": 2}) => sweep, grid: unknown parameter 'M' … m
GridSamples({"m": 0}) => number of values of at least 1 … {'m': 0}
GridSamples({}) => number of values of at least 1 … {}
GridSamples(3) => number of values of at least 1 for some parameters, such as {'m': 3}, got 3
GridSamples({"m": 2.5}) => a whole number of values
RandomSamples(2.5) => at least 1 random sample … count=
RandomSamples(0) => at least 1 random sample … count=0
RandomSamples(1, -1) => a seed of at least 0 … seed=-1
[1.0] => expected GridSamples, RandomSamples or a mapping … got list
{"m": [[1.0]]} => numbers or arrays of one length, got shapes [(1, 1)]
{"m": []} => there are no samples
{"m": [1.0, 3.0]} => sample 1: m = 3 is outside its range [0.5, 2] kg … Widen
{"m": [1.0, np.nan]} => sample 1: m = nan is outside its range
> mbdlft.read_samples({}) => AnalysisError: s.csv: …
tmp_path / "s.csv" => cannot be read
file_of("m,k\n1.0,2.0\n3.0,x\n") => expected names in the first line
file_of("m,m\n1.0,2.0\n") => expected as many different names as columns
file_of("m\n1.0,2.0\n") => expected as many different names as columns
"""
)


def test_shard_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    for place, name in ((staging.os, "fsync"), (sweeps.os, "posix_fallocate"), (sweeps, "_put")):
        with monkeypatch.context() as patch:
            patch.setattr(place, name, full, raising=name != "posix_fallocate")
            with says(ArchiveError, "cannot be written: No space left on device. What is finished stays"):
                mbdlft.sweep(scene(), {}, tmp_path / "a.h5", workers=1)
            assert not list(tmp_path.rglob("fresh.h5"))
    mbdlft.sweep(scene(), {}, tmp_path / "a.h5", workers=1)
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_a_disk_that_is_too_small_is_not_filled(tmp_path: Path) -> None:
    with says(ArchiveError, "cannot be written: it needs ", " bytes, and the disk has "):
        mbdlft.sweep(scene(), RandomSamples(10**15), tmp_path / "a.h5", workers=1)
    assert not list(tmp_path.rglob("*.h5"))


def test_samples_behind_a_byte_order_mark(file_of: Callable[[str], Path]) -> None:
    """Spreadsheets write one; it was a part of the first name."""
    assert list(mbdlft.read_samples(file_of("\ufeffm,k\n1.0,2.0\n"))) == ["m", "k"]


def test_error_of_a_worker_is_that_of_the_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A scene that the workers cannot assemble, though this process could."""
    monkeypatch.setattr(staging, "_SHARD_ROWS", 1)
    monkeypatch.setattr(staging, "scene_to_toml", lambda _: "name = 3")
    with says(SceneError, "the line format = 'mbdlft-scene/1' is missing"):
        mbdlft.sweep(scene(), RandomSamples(10_000), tmp_path / "a.h5", workers=2)
