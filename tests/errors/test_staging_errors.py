"""An unfinished sweep whose files were changed: a named error, or the shard is computed again."""

from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import ArchiveError, MbdlftError, RandomSamples
from mbdlft.archive import archive, hdf5
from mbdlft.archive import sweep as sweep_file
from mbdlft.batch import staging
from tests.archive import models
from tests.close import exact
from tests.errors.scenes import cart
from tests.errors.table import says

SHARD = "shard-0000000.sha256"
ROWS = "rows.h5"


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
    "flipped": lambda data: data[:20] + bytes([data[20] ^ 1]) + data[21:],
    "cut": lambda data: data[:-8],
    "empty": lambda data: b"",
    "longer": lambda data: data + bytes(8),
    "seal": lambda data: data[:-1] + bytes([data[-1] ^ 1]),
}


def resumed(file: Path, given: object) -> int:
    """Samples that were there when the sweep goes on; then it is as if it had not been interrupted."""
    report = mbdlft.sweep(models.arm(), given, file, name="s", workers=1)
    whole = file.with_name("whole.h5")
    mbdlft.sweep(models.arm(), given, whole, name="s", workers=1)
    exact(mbdlft.load_sweep(file).A, mbdlft.load_sweep(whole).A)
    assert not file.with_name(f".{file.name}.s.sweep").exists()
    return report.resumed


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_a_shard_is_computed_again(tmp_path: Path, change: object) -> None:
    file, given = tmp_path / "a.h5", RandomSamples(9000)
    note = started(file, models.arm(), given, shards=2) / SHARD
    note.write_bytes(change(note.read_bytes()))  # type: ignore[operator]
    assert resumed(file, given) == 4096


def test_a_note_in_the_place_of_another(tmp_path: Path) -> None:
    file, given = tmp_path / "a.h5", RandomSamples(12000)
    folder = started(file, models.arm(), given, shards=2)
    (folder / SHARD).write_bytes((folder / SHARD.replace("0.", "1.")).read_bytes())
    with says(ArchiveError, f"{folder / SHARD}: is damaged or was changed"):
        staging.blocks_of(folder, staging.opened(folder))
    (folder / SHARD).write_bytes(b"x")
    with says(ArchiveError, f"{folder / SHARD}: is damaged or was changed. The same sweep computes"):
        staging.blocks_of(folder, staging.opened(folder))
    assert mbdlft.sweep(models.arm(), given, file, name="s", workers=1).resumed == 4096


@pytest.mark.parametrize("key", ["samples", "A", "trim/value", "status"])
def test_rows_that_were_changed_are_computed_again(tmp_path: Path, key: str) -> None:
    """As after the power failed: the note is on the disk, and the rows are not."""
    file, given = tmp_path / "a.h5", RandomSamples(9000)
    folder = started(file, models.arm(), given, shards=2)
    start = staging.places(folder, staging.opened(folder)).starts[key]
    with (folder / ROWS).open("r+b") as stream:
        stream.seek(start)
        stream.write(b"\x01\x02")
    assert resumed(file, given) == 4096


@pytest.mark.parametrize("damage", ["all but the rows", "cut", "empty", "longer", "gone"])
def test_the_file_of_rows_is_made_anew_but_its_rows(tmp_path: Path, damage: str) -> None:
    """As after a kill while the archive was put together: HDF5 cannot open the file."""
    file, given = tmp_path / "a.h5", RandomSamples(9000)
    folder = started(file, models.arm(), given, shards=2)
    rows, data = folder / ROWS, (folder / ROWS).read_bytes()
    match damage:
        case "all but the rows":
            at = staging.places(folder, staging.opened(folder))
            image = bytearray(len(data))
            for key, start in at.starts.items():
                image[start : start + at.sizes[key]] = data[start : start + at.sizes[key]]
            rows.write_bytes(image)
        case "cut":
            rows.write_bytes(data[: len(data) // 2])
        case "longer":
            rows.write_bytes(data + b"x" * 99_999)
        case "empty":
            rows.write_bytes(b"")
        case _:
            rows.unlink()
    assert resumed(file, given) == (8192 if damage in ("all but the rows", "longer") else 0)


def test_a_kill_while_the_archive_is_put_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At each thing that is written into the file: the old archive stays, and no sample is lost."""
    file, given = tmp_path / "a.h5", RandomSamples(9000)
    mbdlft.save(file, models.arm())
    before = file.read_bytes()
    steps = ((hdf5, "copy_all"), (sweep_file, "write_items"), (archive, "seal_file"))
    for k, (module, step) in enumerate(steps):

        def stop(*_: object, **__: object) -> None:
            raise Stop

        with monkeypatch.context() as patch:
            patch.setattr(module, step, stop)
            with pytest.raises(Stop):
                mbdlft.sweep(models.arm(), given, file, name="s", workers=1)
        assert file.read_bytes() == before
        rows = tmp_path / ".a.h5.s.sweep" / ROWS
        data = rows.read_bytes()  # as the process was killed before the file was closed
        rows.write_bytes(data[:40] + b"\xff" * 8 + data[48:])
        if k:
            report = mbdlft.sweep(models.arm(), given, file, name="s", workers=1)
            assert report.resumed == 9000
            assert mbdlft.model_names(file) == ("two_link_arm",)
            mbdlft.save(file, models.arm())
            before = file.read_bytes()


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
