"""Writers of one file: locks, links that are followed, leftovers that are removed.

That two writers lose nothing is a class of tests/attack.
"""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

import mbdlft
from mbdlft import ArchiveError, load, load_sweep, model_names, save
from mbdlft.archive import archive
from tests.archive import models
from tests.archive.plain_digest import digest
from tests.close import CLOSED_FORM, exact, target
from tests.errors.table import says

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


def test_lock_of_a_dead_process(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    program = (
        "import sys, time\nfrom pathlib import Path\nfrom mbdlft.archive.archive import locked\n"
        "with locked(Path(sys.argv[1])):\n    print('inside', flush=True)\n    time.sleep(600)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(file)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "inside\n"
            assert (tmp_path / "a.h5.lock").exists()
        finally:
            process.send_signal(signal.SIGKILL)
    save(file, models.bare())
    assert list(tmp_path.iterdir()) == [file]


def test_lock_that_is_never_released(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "_PATIENCE", 0.0)
    file = tmp_path / "a.h5"
    with (
        archive.locked(file),
        says(ArchiveError, f"{file}: cannot be written: process {os.getpid()} holds {file}.lock for 0 s"),
    ):
        save(file, models.bare())
    save(file, models.bare())


def test_a_lock_that_was_removed_meanwhile_is_none(tmp_path: Path) -> None:
    """Whoever waits for a lock whose file is gone takes the next one."""
    lock = tmp_path / "a.lock"
    handle = archive._open(lock)
    assert archive._is_same(handle, lock)
    lock.unlink()
    assert not archive._is_same(handle, lock)
    lock.write_text("")
    assert not archive._is_same(handle, lock)
    os.close(handle)


def test_leftovers(tmp_path: Path) -> None:
    others = [".b.h5.abcdefgh.part", ".a.h5.b.abcdefgh.part", ".a.h5.short.part", "a.h5.part"]
    for name in (".a.h5.abcdef_0.part", *others):
        (tmp_path / name).write_text("x")
    save(tmp_path / "a.h5", models.bare())
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*others, "a.h5"])


def test_links_are_followed(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "link.h5").symlink_to(tmp_path / "data" / "a.h5")
    for name in ("one", "two"):
        save(tmp_path / "link.h5", models.bare(), name)
        assert (tmp_path / "link.h5").is_symlink()
        assert [path.name for path in (tmp_path / "data").iterdir()] == ["a.h5"]
    assert model_names(tmp_path / "data" / "a.h5") == ("one", "two")
    (tmp_path / "loop.h5").symlink_to(tmp_path / "loop.h5")
    with says(ArchiveError, "loop.h5: cannot be written: it is a link that leads to itself"):
        save(tmp_path / "loop.h5", models.bare())


def test_files_of_1_0_are_read_and_kept(tmp_path: Path) -> None:
    file = shutil.copy(HERE / "archive_1_0.h5", tmp_path / "a.h5")
    assert model_names(file) == ("numbers", "turned_arm")
    before = load(file, "turned_arm")
    agrees(before)
    rows = load_sweep(file)
    target(rows.A, mbdlft.matrices_at(before, _values(rows)).A, CLOSED_FORM)
    save(file, models.strange(4))
    models.same(load(file, "turned_arm"), before)
    exact(load_sweep(file).A, rows.A)
    with h5py.File(file) as archive:
        assert archive.attrs["format_version"] == b"1.1"
        assert archive["models/turned_arm"].attrs["encoding_version"] == "1.0"


def agrees(found: mbdlft.LFTModel) -> None:
    """The model has the values of the one that is made today; how they are computed may have changed."""
    today = models.turned_arm()
    assert (found.states, found.inputs, found.outputs) == (today.states, today.inputs, today.outputs)
    assert found.certificate.order == tuple(block.size for block in found.lft.blocks)
    points = mbdlft.random(today.parameters, 5, seed=2)
    for a, b in zip(mbdlft.matrices_at(found, points), mbdlft.matrices_at(today, points), strict=True):
        target(a, b, CLOSED_FORM)


def _values(rows: mbdlft.Sweep) -> dict[str, object]:
    return {signal.name: rows.samples[:, k] for k, signal in enumerate(rows.layout.parameters)}


def test_files_of_1_1_are_read() -> None:
    file = HERE / "archive_1_1.h5"
    assert model_names(file) == ("mixed", "turned_arm")
    found = load(file, "turned_arm")
    agrees(found)
    rows = load_sweep(file)
    target(rows.A, mbdlft.matrices_at(found, _values(rows)).A, CLOSED_FORM)
    assert [block.kind for block in load(file, "mixed").lft.blocks][:2] == ["full", "complex"]
    with h5py.File(file) as archive:
        for path in ("models/mixed", "models/turned_arm", "sweeps/sweep"):
            assert digest(archive[path]) == archive[path].attrs["digest"].decode()


def test_what_cannot_be_read_is_never_dropped(tmp_path: Path) -> None:
    """A group with a damaged header: its models would have vanished with the next save."""
    file = tmp_path / "a.h5"
    save(file, models.arm())
    whole = file.read_bytes()
    with h5py.File(file) as archive:
        address = h5py.h5o.get_info(archive["models"].id).addr
    damaged = bytearray(whole)
    damaged[address + 8] ^= 1
    file.write_bytes(damaged)
    for attempt in (model_names, load, lambda path: save(path, models.bare())):
        with says(ArchiveError, f"{file}: is not a whole HDF5 file"):
            attempt(file)
    assert file.read_bytes() == damaged


def test_models_that_are_no_group_any_more(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    save(file, models.arm())
    with h5py.File(file, "r+") as archive:
        archive["models"]["more"] = 1.0
    assert model_names(file) == ("more", "two_link_arm")
    with says(ArchiveError, "model 'more': /models/more is not a group"):
        load(file, "more")
