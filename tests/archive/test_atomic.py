"""Writing is atomic: after a full disk, an interruption or a kill the old file is whole."""

import errno
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from mbdlft import ArchiveError, load, model_names, save
from tests.archive import models
from tests.archive.models import same
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
    run = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(old), str(limit)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=True,
    )
    assert run.stdout == (
        f"{old}: cannot be written: {os.strerror(errno.EFBIG)}. The old file, if there was one, is "
        "unchanged.\n"
    )
    assert run.stderr == ""
    check_unchanged(old, before)


def test_disk_that_is_not_full(old):
    subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(old), "1000000"], cwd=ROOT, timeout=SECONDS, check=True
    )
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
