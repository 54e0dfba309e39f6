"""Writing is atomic: after a full disk, an interruption or a kill the old file is whole."""

import errno
import os
import shutil
import signal
import stat
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

import mbdlft
from mbdlft import ArchiveError, load, load_sweep, model_names, save
from mbdlft.archive import archive
from tests.apart import printed
from tests.archive import models
from tests.archive.models import same
from tests.archive.plain_digest import digest
from tests.close import CLOSED_FORM, exact, target
from tests.errors.table import says

ROOT = Path(__file__).parents[2]
SECONDS = 60
FULL_DISK = """
import resource, signal, sys
from mbdlft import ArchiveError, load, save

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
file, limit = sys.argv[1], int(sys.argv[2])
model = load(file)
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    save(file, model, "second")
except ArchiveError as error:
    print(error)
"""
KILLED = """
import os, sys, time
from mbdlft import load, save

def wait(handle):
    print("inside", flush=True)
    time.sleep(600)

model = load(sys.argv[1])
os.fsync = wait
save(sys.argv[1], model, "second")
"""


@pytest.fixture
def old(tmp_path):
    """An archive that is alone in its folder, and a check that this is still so."""
    file = tmp_path / "arm.h5"
    save(file, models.arm())
    return file


def check_unchanged(file, before):
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == [file.name]
    same(load(file), models.arm())


@pytest.mark.parametrize("limit", [0, 1, 4096, 40000])
def test_full_disk(old, limit):
    before = old.read_bytes()
    assert printed(FULL_DISK, old, limit) == (
        f"{old}: cannot be written: {os.strerror(errno.EFBIG)}. The old file, if there was one, is "
        "unchanged.\n"
    )
    check_unchanged(old, before)


def test_disk_that_is_not_full(old):
    assert printed(FULL_DISK, old, 1000000) == ""
    assert model_names(old) == ("second", "two_link_arm")


@pytest.mark.parametrize("step", ["fsync", "chmod", "replace"])
def test_interrupted(old, monkeypatch, step):
    before, called = old.read_bytes(), []

    def interrupt(*arguments, **options):
        called.append(step)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os, step, interrupt)
        with pytest.raises(KeyboardInterrupt):
            save(old, models.strange(6))
    assert called
    check_unchanged(old, before)


@pytest.mark.parametrize("step", ["fsync", "chmod", "replace"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_error_of_the_system(old, monkeypatch, step, number):
    before = old.read_bytes()

    def fail(*arguments, **options):
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(os, step, fail)
        with says(ArchiveError, f"{old}: cannot be written: {os.strerror(number)}. The old file"):
            save(old, models.strange(6))
    check_unchanged(old, before)


def test_interrupted_first_write_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(handle):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        save(tmp_path / "arm.h5", models.arm())
    assert list(tmp_path.iterdir()) == []


def test_killed_while_writing(old):
    before = old.read_bytes()
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, str(old)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "inside\n"
        beside = list(old.parent.glob("*.part"))
        process.send_signal(signal.SIGKILL)
        assert process.wait(SECONDS) == -signal.SIGKILL
        assert len(beside) == 1  # it was killed in the middle: the new file is there, unused
        assert len(beside[0].read_bytes()) > len(before)
    assert old.read_bytes() == before
    same(load(old), models.arm())
    save(old, models.strange(6), "second")
    assert model_names(old) == ("second", "two_link_arm")
    assert list(old.parent.iterdir()) == [old]  # what the killed writer has left is gone


def test_rights_of_the_file(old, tmp_path):
    old.chmod(0o640)
    save(old, models.arm())
    assert stat.S_IMODE(old.stat().st_mode) == 0o640
    mask = os.umask(0o027)
    try:
        save(tmp_path / "new.h5", models.arm())
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "new.h5").stat().st_mode) == 0o640


# Writers of one file: locks, links that are followed, leftovers that are removed.
# That two writers lose nothing is a class of tests/attack.

HERE = Path(__file__).parent
ROOT_WRITERS = HERE.parents[1]


def test_lock_of_a_dead_process(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    program = (
        "import sys, time\nfrom pathlib import Path\nfrom mbdlft.archive.archive import locked\n"
        "with locked(Path(sys.argv[1])):\n    print('inside', flush=True)\n    time.sleep(600)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(file)], cwd=ROOT_WRITERS, stdout=subprocess.PIPE, text=True
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
