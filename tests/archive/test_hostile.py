"""Files made to do harm, or damaged so that the HDF5 library fails: an ArchiveError in time."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdlft
from mbdlft import ArchiveError, load, load_sweep, model_names, save
from mbdlft.archive import reading
from mbdlft.base import worker
from tests.archive import models
from tests.archive.plain_digest import as_words, digest, edit, put_text
from tests.errors.table import says

HERE = Path(__file__).parent
GROUP = "models/two_link_arm"
DAMAGED = sorted((HERE / "damaged").glob("*.h5"))


@pytest.fixture
def file(tmp_path):
    save(tmp_path / "arm.h5", models.arm())
    return tmp_path / "arm.h5"


@pytest.mark.parametrize("source", DAMAGED, ids=lambda path: path.stem)
def test_files_that_the_library_cannot_stand(tmp_path, source, monkeypatch):
    """A virtual dataset that ends the process, a heap without end, models that vanished."""
    monkeypatch.setattr(reading, "_SECONDS", 1)  # a file without end takes all of them
    file = shutil.copy(source, tmp_path / "a.h5")
    before = file.read_bytes()
    with says(ArchiveError, f"{file}: "):
        load(file, "two_link_arm")
    with says(ArchiveError, f"{file}: ", "Nothing is written."):
        save(file, models.arm(), "new")
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]
    # one has names, and models beside the hostile one; another takes all of its seconds (below)
    if source.stem not in ("segv_vds", "hang9"):
        with says(ArchiveError, f"{file}: "):
            model_names(file)


def test_the_next_file_is_read_after_one_that_ended_the_helper(tmp_path, file):
    hang = shutil.copy(HERE / "damaged" / "hang9.h5", tmp_path / "hang.h5")
    with says(ArchiveError, "the HDF5 library did not end on it"):
        model_names(hang)
    models.same(load(file, isolated=True), models.arm())


def soft(group):
    del group["A"]
    group["A"] = h5py.SoftLink("D_zw")


def external(group):
    del group["A"]
    group["A"] = h5py.ExternalLink("other.h5", "/A")


def hard(group):
    group["trim/again"] = group["trim"]


def twice(group):
    group["second"] = group["A"]


def virtual(group):
    del group["A"]
    layout = h5py.VirtualLayout((4, 4), "<f8")
    layout[:] = h5py.VirtualSource("/etc/hostname", "A", (4, 4))
    group.create_virtual_dataset("A", layout)


def elsewhere(group):
    del group["A"]
    group.create_dataset("A", (4, 4), "<f8", external=[("/etc/hostname", 0, 128)])


def filtered(group):
    del group["A"]
    group.create_dataset("A", data=np.eye(4), compression="lzf")


def reference(group):
    group["states"].attrs["to"] = group["A"].ref


def committed(group):
    group.file["kind"] = np.dtype("<f8")
    del group["A"]
    group.create_dataset("A", (4, 4), dtype=group.file["kind"])


def type_in_the_group(group):
    group["kind"] = np.dtype("<f8")


def no_value(group):
    group["nothing"] = h5py.Empty("f8")


def big_endian(group):
    value = group["A"][()]
    del group["A"]
    group["A"] = value.astype(">f8")


def single(group):
    value = group["A"][()]
    del group["A"]
    group["A"] = value.astype("<f4")


def long_text(group):
    del group["states/name"]
    group["states/name"] = ["a", "b", "c", "d"]


def at(group):
    group["A@b"] = np.eye(2)


def at_attribute(group):
    group.attrs["a@b"] = 1.0


def deep(group):
    group.create_group("/".join("a" * 20))


HOSTILE = {
    soft: "'A' is a link to another place or file",
    external: "'A' is a link to another place or file",
    hard: "is linked twice",
    twice: "is linked twice",
    virtual: "A is a virtual dataset",
    elsewhere: "A has its numbers in another file",
    filtered: "A has the filter 32000; gzip, shuffle, fletcher32 are read",
    reference: "states@to has the type object, expected float64",
    committed: "A has a type that is stored elsewhere",
    type_in_the_group: "kind is a type and not data",
    no_value: "nothing has no value",
    big_endian: "A has the type >f8, expected float64",
    single: "the dataset 'A' has the type float32, expected float64",
    long_text: "states/name is text of variable length, expected text of fixed length",
    at: "A@b: a name with '@' cannot be that of an item",
    at_attribute: "@a@b: a name with '@' cannot be that of an item",
    deep: "is linked twice, or lies too deep",
}


@pytest.mark.parametrize("change", HOSTILE, ids=lambda change: change.__name__)
def test_what_no_archive_has(file, change):
    edit(file, change, GROUP)
    for isolated in (False, True):
        with says(ArchiveError, f"{file}: model 'two_link_arm'", HOSTILE[change]):
            load(file, isolated=isolated)
    # a seal says only that nobody has changed the file since
    file.write_bytes(reading.sealed(file.read_bytes()))
    with says(ArchiveError, f"{file}: model 'two_link_arm'", HOSTILE[change]):
        load(file)


def test_a_link_among_the_models(file):
    with h5py.File(file, "r+") as archive:
        archive["models/b"] = h5py.ExternalLink("other.h5", "/")
    for attempt in (load, model_names, lambda path: save(path, models.arm(), "c")):
        with says(ArchiveError, f"{file}: ", "'b' is a link to another place"):
            attempt(file)


def huge(group):
    del group["A"]
    group.create_dataset("A", (4, 4), "<f8", chunks=(1, 4))
    group.create_dataset("more", (10**6, 10**6), "<f8", chunks=(1000, 1000))


def huge_chunk(group):
    del group["D_zw"]
    group.create_dataset("D_zw", (17, 17), "<f8", maxshape=(None, None), chunks=(2**14, 2**14))


def bomb(group):
    group.create_dataset("more", data=np.zeros(2**27, np.uint8), compression="gzip")


@pytest.mark.parametrize("change", [huge, huge_chunk, bomb])
def test_memory(file, change):
    """Zeros of 128 MB packed in 128 kB, a terabyte that was never written."""
    edit(file, change, GROUP, right=False)
    limit = 2**26 if change is bomb else 2**30
    with says(ArchiveError, "model 'two_link_arm' needs more than", "bytes of memory at"):
        load(file, limit=limit)


def test_a_larger_limit(file):
    with says(ArchiveError, "needs more than 1000 bytes of memory"):
        load(file, limit=1000)
    models.same(load(file, limit=100_000), models.arm())


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda g: g["certificate/order"].__setitem__(0, 9), "order is (9, 2,"),
        (lambda g: g["certificate/lower_bound"].__setitem__(0, 9), "more than the order"),
        (lambda g: g["certificate/lower_bound"].__setitem__(0, -1), "lower_bound has a negative"),
        (lambda g: g["certificate"].attrs.__setitem__("max_relative_error", np.nan), "is nan"),
        (lambda g: g["certificate"].attrs.__setitem__("max_relative_error", np.inf), "is inf"),
        (lambda g: g["certificate"].attrs.__setitem__("max_relative_error", -1.0), "is -1.0"),
        (lambda g: g["certificate"].attrs.__setitem__("check_points", -1), "check_points is -1"),
        (lambda g: g["certificate"].attrs.__setitem__("truncation_error", 1.0), "exact is true"),
        (lambda g: g["certificate"].attrs.__setitem__("exact", 1), "has the type int64, expected bool"),
        (lambda g: put_text(g["certificate"], "well_posed", "yes"), "well_posed is 'yes'"),
        (lambda g: g["certificate/evidence/basis"].__setitem__(0, b"belief"), "evidence: expected"),
        (lambda g: g["parameters/name"].__setitem__(1, g["parameters/name"][0]), "stands twice"),
        (lambda g: g["inputs/name"].__setitem__(1, g["inputs/name"][0]), "stands twice"),
        (lambda g: g["states/name"].__setitem__(0, b"\xff"), "states/name is not UTF-8 text"),
        (lambda g: g["provenance/scene"].__setitem__(0, 255), "provenance/scene is not UTF-8 text"),
        (lambda g: g["delta/kind"].__setitem__(0, b"fool"), "block 'J1' is 'fool', 1 x 1"),
        (lambda g: g["delta/rows"].__setitem__(0, 2), "block 'J1' is 'real', 2 x 1"),
        (
            lambda g: (g["delta/rows"].__setitem__(0, 2), g["delta/columns"].__setitem__(0, 2)),
            "delta/rows: expected 17 together",
        ),
    ],
)  # fmt: skip
def test_values_that_cannot_be_true(file, change, text):
    edit(file, change, GROUP)
    with says(ArchiveError, f"{file}: model 'two_link_arm'", text):
        load(file)


def test_digest(file):
    """One bit of a number, a name, an attribute: what is read is what was written, or nothing."""
    with h5py.File(file) as archive:
        stored = archive[GROUP].attrs["digest"].decode()
        assert stored == digest(archive[GROUP])
    for change in (
        lambda g: g["A"].__setitem__((0, 0), np.nextafter(g["A"][0, 0], 9.0)),
        lambda g: g["states/name"].__setitem__(0, b"x"),
        lambda g: g["certificate"].attrs.__setitem__("seed", 3),
        lambda g: put_text(g, "description", "other"),
        lambda g: g.create_dataset("more", data=1.0),
        lambda g: put_text(g, "digest", "0"),
    ):
        save(file, models.arm())
        edit(file, change, GROUP, right=False)
        with says(ArchiveError, "model 'two_link_arm' is damaged or was changed: its digest is"):
            load(file)
    save(file, models.arm())
    edit(file, lambda g: g.attrs.__delitem__("digest"), GROUP)
    with says(ArchiveError, "is not whole: the attribute 'digest' is missing"):
        load(file)


def test_digest_of_rows(file):
    mbdlft.sweep(models.arm(), mbdlft.RandomSamples(5000), file, name="s", workers=1)
    with h5py.File(file) as archive:
        assert archive["sweeps/s"].attrs["digest"].decode() == digest(archive["sweeps/s"])
        assert archive["sweeps/s/blocks"].shape == (2, 32)
        assert as_words(archive["sweeps/s/states/name"]) == [s.name for s in models.arm().states]
    edit(file, lambda g: g["A"].__setitem__((4500, 0, 0), 1.0), "sweeps/s", right=False)
    assert load_sweep(file, stop=4096).A.shape == (4096, 4, 4)
    with says(ArchiveError, "sweep 's' is damaged or was changed: rows 4096 to 4999 do not have"):
        load_sweep(file, start=4990)
    with h5py.File(file, "r+") as archive:
        del archive["sweeps/s/blocks"]
        archive["sweeps/s/blocks"] = np.zeros((1, 32), np.uint8)
        put_text(archive["sweeps/s"], "digest", digest(archive["sweeps/s"]))
    with says(ArchiveError, "sweep 's': blocks: expected 2 digests, got 1"):
        load_sweep(file)
    with h5py.File(file, "r+") as archive:
        archive["sweeps/s"].attrs["block_rows"] = 0
    with says(ArchiveError, "@block_rows is 0, expected at least 1"):
        load_sweep(file)


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("status", 1, "A does not agree with status"),
        ("status", 3, "status has a number that means nothing"),
        ("A", np.nan, "A does not agree with status"),
    ],
)
def test_rows_that_cannot_be_true(tmp_path, key, value, text):
    """In a file of version 1.0, which has no digest."""
    file = shutil.copy(HERE / "archive_1_0.h5", tmp_path / "a.h5")
    edit(file, lambda g: g[key].__setitem__(0, value), "sweeps/sweep")
    with says(ArchiveError, "sweep 'sweep': ", text):
        load_sweep(file)


def test_what_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with says(ArchiveError, "cannot be read: it is not a regular file"):
        load(tmp_path / "pipe")
    with says(ArchiveError, "expected the name of a model, got 3"):
        load(tmp_path / "pipe", 3)


def test_helper_that_does_not_start(file, monkeypatch):
    reading._READER.end()
    monkeypatch.setattr(sys, "executable", "/none")
    with says(ArchiveError, f"{file}: has no intact seal, and the process that reads such files"):
        load(file, isolated=True)
    monkeypatch.undo()
    models.same(load(file, isolated=True), models.arm())


def test_helper_is_one_process_and_ends(file):
    program = (
        "import sys, mbdlft; from mbdlft.archive import reading\n"
        "for _ in range(3): mbdlft.load(sys.argv[1], isolated=True)\n"
        "print(reading._READER.process.pid)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program, str(file)],
        cwd=HERE.parents[1],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stderr == ""
    assert not Path(f"/proc/{done.stdout.strip()}").exists()


def test_a_message_that_is_cut_off():
    """What comes back from the other process may be any bytes."""
    import io

    head = b'{"arrays": [["a", "<f8", [2]]]}'
    for message in (
        b"",
        b"\x05\0\0\0\0\0\0\0{",
        b"\x02\0\0\0\0\0\0\0[]",
        b"\x02\0\0\0\0\0\0\0{}",
        len(head).to_bytes(8, "little") + head + b"\0" * 15,
        len(head).to_bytes(8, "little") + head.replace(b"<f8", b"|O8") + b"\0" * 16,
    ):
        with pytest.raises(EOFError):
            worker._receive_arrays(io.BytesIO(message))
    message = len(head).to_bytes(8, "little") + head + b"\0" * 16
    assert worker._receive_arrays(io.BytesIO(message))[1]["a"].tolist() == [0.0, 0.0]
