"""An unfinished sweep whose files were changed: a named error, or the shard is computed again."""

from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import ArchiveError, MbdlftError, RandomSamples
from mbdlft.batch import staging
from tests.archive import models
from tests.close import exact
from tests.errors.scenes import cart, says

SHARD = "shard-0000000.f8"


class Stop(Exception):  # noqa: N818
    """An interruption."""


def started(file: Path, source: object, samples: object, *, shards: int = 1) -> Path:
    """The folder of a sweep that was interrupted when some shards were finished."""

    def interrupt(done: int, _: int) -> None:
        if done >= shards * 4096:
            raise Stop

    with pytest.raises(Stop):
        mbdlft.sweep(source, samples, file, name="s", workers=1, progress=interrupt)
    return file.parent / f".{file.name}.s.sweep"


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(staging, "_SHARD_ROWS", 4096)


CHANGES = {
    "flipped": lambda data: data[:100] + bytes([data[100] ^ 1]) + data[101:],
    "cut": lambda data: data[:-8],
    "empty": lambda data: b"",
    "longer": lambda data: data + bytes(8),
    "seal": lambda data: data[:-1] + bytes([data[-1] ^ 1]),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_a_shard_is_computed_again(tmp_path: Path, change: object) -> None:
    file, given = tmp_path / "a.h5", RandomSamples(9000)
    folder = started(file, models.arm(), given, shards=2)
    shard = folder / SHARD
    shard.write_bytes(change(shard.read_bytes()))  # type: ignore[operator]
    report = mbdlft.sweep(models.arm(), given, file, name="s", workers=1)
    assert report.resumed == 4096
    mbdlft.sweep(models.arm(), given, tmp_path / "b.h5", name="s", workers=1)
    exact(mbdlft.load_sweep(file).A, mbdlft.load_sweep(tmp_path / "b.h5").A)


def test_a_shard_in_the_place_of_another(tmp_path: Path) -> None:
    file, given = tmp_path / "a.h5", RandomSamples(12000)
    folder = started(file, models.arm(), given, shards=2)
    (folder / SHARD).write_bytes((folder / SHARD.replace("0.", "1.")).read_bytes())
    assert mbdlft.sweep(models.arm(), given, file, name="s", workers=1).resumed == 4096


def test_a_shard_that_changes_while_it_is_put_together(tmp_path: Path) -> None:
    folder = started(tmp_path / "a.h5", models.arm(), RandomSamples(9000))
    work = staging.opened(folder)
    (folder / SHARD).write_bytes(b"x")
    with says(
        ArchiveError, f"{folder / SHARD}: is damaged or was changed. The same sweep computes"
    ):
        next(iter(staging.read_shards(folder, work)))


@pytest.mark.parametrize("change", [CHANGES["flipped"], CHANGES["cut"], CHANGES["empty"]])
def test_plan(tmp_path: Path, change: object) -> None:
    file, given = tmp_path / "a.h5", RandomSamples(9000)
    folder = started(file, models.arm(), given)
    plan = folder / "plan.json"
    plan.write_bytes(change(plan.read_bytes()))  # type: ignore[operator]
    for attempt in (
        lambda: staging.opened(folder),
        lambda: mbdlft.sweep(models.arm(), given, file, name="s", workers=1),
    ):
        with says(ArchiveError, f"{plan}: is damaged or was changed. Start the sweep again"):
            attempt()
    assert mbdlft.sweep(models.arm(), given, file, name="s", workers=1, restart=True).resumed == 0


def test_source_and_samples(tmp_path: Path) -> None:
    """What workers read is what the sweep was started with."""
    m = mbdlft.Parameter("m", 1.0, low=0.5, high=2.0, unit="kg")
    values = {"m": np.linspace(0.5, 2.0, 9000)}
    folder = started(tmp_path / "a.h5", cart("m", [m]), values)
    for name, old, new in (
        ("scene.toml", b"high = 2.0", b"high = 3.0"),
        ("scene.toml", b"high = 2.0", b"high = \xff.0"),
        ("samples.npy", values["m"][5].tobytes(), values["m"][6].tobytes()),
        ("samples.npy", b"NUMPY", b"DUMPY"),
        ("samples.npy", b"'descr'", b"'descx'"),
    ):
        file = folder / name
        whole = file.read_bytes()
        assert old in whole
        file.write_bytes(whole.replace(old, new, 1))
        with says(MbdlftError, f"{folder}", ": is damaged or was changed"):
            staging.opened(folder)
        file.write_bytes(whole)
    staging.opened(folder)
    model = started(tmp_path / "b.h5", models.arm(), RandomSamples(9000)) / "model.h5"
    whole = bytearray(model.read_bytes())
    whole[len(whole) // 2] ^= 1
    model.write_bytes(whole)
    with says(ArchiveError, f"{model}: "):
        staging.opened(model.parent)
