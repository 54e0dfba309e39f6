"""Files made to do harm, or damaged so that the HDF5 library fails: an ArchiveError in time."""

import os
import shutil
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdlft
from mbdlft import ArchiveError, load, load_sweep, model_names, save
from mbdlft.archive import reading
from mbdlft.base import worker
from tests.apart import printed
from tests.archive import models
from tests.archive.plain_digest import as_words, attributes, digest, edit, instead, made, put, put_text
from tests.errors.table import refused, says

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
    file, endless = shutil.copy(source, tmp_path / "a.h5"), source.stem == "hang9"
    before = file.read_bytes()
    with monkeypatch.context() as patch:
        if endless:  # it takes all that there is, up to the next whole second
            patch.setattr(reading, "_SECONDS", 0)
        with says(ArchiveError, f"{file}: ", "the HDF5 library did not end on it" if endless else ""):
            load(file, "two_link_arm")
        with says(ArchiveError, f"{file}: ", "Nothing is written."):
            save(file, models.arm(), "new")
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]
    # one has names, and models beside the hostile one; another takes all of its seconds (above)
    if source.stem not in ("segv_vds", "hang9"):
        with says(ArchiveError, f"{file}: "):
            model_names(file)
    save(tmp_path / "next.h5", models.arm())
    models.same(load(tmp_path / "next.h5", isolated=True), models.arm())


def virtual(group):
    del group["A"]
    layout = h5py.VirtualLayout((4, 4), "<f8")
    layout[:] = h5py.VirtualSource("/etc/hostname", "A", (4, 4))
    group.create_virtual_dataset("A", layout)


def committed(group):
    group.file["kind"] = np.dtype("<f8")
    del group["A"]
    group.create_dataset("A", (4, 4), dtype=group.file["kind"])


def reference(group):
    group["states"].attrs["to"] = group["A"].ref


def huge(group):
    made("A", (4, 4), "<f8", chunks=(1, 4))(group)
    group.create_dataset("more", (10**6, 10**6), "<f8", chunks=(1000, 1000))


def message_of(read):
    with pytest.raises(ArchiveError) as caught:
        read()
    return str(caught.value)


@pytest.fixture
def changed(file):
    """Reads a changed model, here and in the other process, and raises what both say."""

    def read(change, *, right=True, **options):
        edit(file, change, GROUP, right=right)
        said = [message_of(lambda: load(file, **options))]
        said.append(message_of(lambda: load(file, isolated=True, **options)))
        # a seal says only that nobody has changed the file since
        file.write_bytes(reading.sealed(file.read_bytes()))
        said.append(message_of(lambda: load(file, **options)))
        (message,) = set(said)
        assert message.startswith(f"{file}: model 'two_link_arm'")
        raise ArchiveError(message)

    return read


@pytest.fixture
def rows_of(tmp_path):
    def read(key, value):
        file = shutil.copy(HERE / "archive_1_0.h5", tmp_path / "a.h5")
        edit(file, put(key, 0, value), "sweeps/sweep")
        load_sweep(file)

    return read


test_messages = refused(
    r"""
> changed({}) => ArchiveError:
instead("A", h5py.SoftLink("D_zw")) => 'A' is a link to another place or file
instead("A", h5py.ExternalLink("other.h5", "/A")) => 'A' is a link to another place or file
lambda g: {g.__setitem__("trim/again", g["trim"])|g.__setitem__("second", g["A"])} => is linked twice
virtual => A is a virtual dataset
made("A", (4, 4), "<f8", external=[("/etc/hostname", 0, 128)]) => A has its numbers in another file
made("A", data=np.eye(4), compression="lzf")
    => A has the filter 32000; gzip, shuffle, fletcher32 are read
reference => states@to has the type object, expected float64
committed => A has a type that is stored elsewhere
instead("kind", np.dtype("<f8")) => kind is a type and not data
instead("nothing", h5py.Empty("f8")) => nothing has no value
instead("A", np.zeros((4, 4), ">f8")) => A has the type >f8, expected float64
instead("A", np.zeros((4, 4), "<f4")) => the dataset 'A' has the type float32, expected float64
instead("states/name", ["a", "b", "c", "d"])
    => states/name is text of variable length, expected text of fixed length
instead("A@b", np.eye(2)) => A@b: a name with '@' cannot be that of an item
attributes("", **{"a@b": 1.0}) => @a@b: a name with '@' cannot be that of an item
lambda g: g.create_group("/".join("a" * 20)) => is linked twice, or lies too deep
# Zeros of 128 MB packed in 128 kB, a terabyte that was never written.
> changed({}, right=False) => ArchiveError: needs more than … bytes of memory at
huge, limit=2**30
made("D_zw", (17, 17), "<f8", maxshape=(None, None), chunks=(2**14, 2**14)), limit=2**30
made("more", data=np.zeros(2**27, np.uint8), compression="gzip"), limit=2**26
> changed({}) => ArchiveError:
put("certificate/order", 0, 9) => order is (9, 2,
put("certificate/lower_bound", 0, 9) => more than the order
put("certificate/lower_bound", [0, 1], [2, 1]) => together 16, is more than the order
put("certificate/lower_bound", 0, -1) => lower_bound has a negative
made("certificate/accelerations", data=np.array([2], "<i8")) => accelerations: there are 2 outputs
made("certificate/unmoved", data=np.array([[0, 9]], "<i8")) => unmoved: there are 2 outputs
made("certificate/driven", data=np.array([99], "<i8")) => driven: there are
made("certificate/beside", data=np.array([-1], "<i8")) => beside: there are
attributes("certificate", max_relative_error=np.nan) => is nan
attributes("certificate", max_relative_error=np.inf) => is inf
attributes("certificate", max_relative_error=-1.0) => is -1.0
attributes("certificate", check_points=-1) => check_points is -1
attributes("certificate", truncation_error=1.0) => exact is true
attributes("certificate", exact=1) => has the type int64, expected bool
attributes("certificate", well_posed="yes") => well_posed is 'yes'
put("certificate/evidence/basis", 0, b"belief") => evidence: expected
lambda g: put("parameters/name", 1, g["parameters/name"][0])(g) => stands twice
lambda g: put("inputs/name", 1, g["inputs/name"][0])(g) => stands twice
put("states/name", 0, b"\xff") => states/name is not UTF-8 text
put("provenance/scene", 0, 255) => provenance/scene is not UTF-8 text
put("delta/kind", 0, b"fool") => block 'J1' is 'fool', 1 x 1
put("delta/rows", 0, 2) => block 'J1' is 'real', 2 x 1
lambda g: (put("delta/rows", 0, 2)(g), put("delta/columns", 0, 2)(g)) => delta/rows: expected 17 together
> rows_of({}) => ArchiveError: sweep 'sweep':
# In a file of version 1.0, which has no digest.
"status", 1 => A does not agree with status
"status", 3 => status has a number that means nothing
"A", np.nan => A does not agree with status
"""
)


def test_a_link_among_the_models(file):
    with h5py.File(file, "r+") as archive:
        archive["models/b"] = h5py.ExternalLink("other.h5", "/")
    for attempt in (load, model_names, lambda path: save(path, models.arm(), "c")):
        with says(ArchiveError, f"{file}: ", "'b' is a link to another place"):
            attempt(file)


def test_a_larger_limit(file):
    with says(ArchiveError, "needs more than 1000 bytes of memory"):
        load(file, limit=1000)
    models.same(load(file, limit=100_000), models.arm())


def test_digest(file):
    """One bit of a number, a name, an attribute: what is read is what was written, or nothing."""
    with h5py.File(file) as archive:
        stored = archive[GROUP].attrs["digest"].decode()
        assert stored == digest(archive[GROUP])
    for change in (
        lambda g: put("A", (0, 0), np.nextafter(g["A"][0, 0], 9.0))(g),
        put("states/name", 0, b"x"),
        attributes("certificate", seed=3),
        attributes("", description="other"),
        made("more", data=1.0),
        attributes("", digest="0"),
    ):
        save(file, models.arm())
        edit(file, change, GROUP, right=False)
        with says(ArchiveError, "model 'two_link_arm' is damaged or was changed: its digest is"):
            load(file)
    save(file, models.arm())
    edit(file, attributes("", digest=None), GROUP)
    with says(ArchiveError, "is not whole: the attribute 'digest' is missing"):
        load(file)


def test_digest_of_rows(file):
    mbdlft.sweep(models.arm(), mbdlft.RandomSamples(5000), file, name="s", workers=1)
    with h5py.File(file) as archive:
        assert archive["sweeps/s"].attrs["digest"].decode() == digest(archive["sweeps/s"])
        assert archive["sweeps/s/blocks"].shape == (2, 32)
        assert as_words(archive["sweeps/s/states/name"]) == [s.name for s in models.arm().states]
    edit(file, put("A", (4500, 0, 0), 1.0), "sweeps/s", right=False)
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
    assert not Path(f"/proc/{printed(program, file).strip()}").exists()


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
