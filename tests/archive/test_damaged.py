"""Files that are missing, cut, foreign, newer, incomplete or damaged: always an ArchiveError."""

import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from mbdlft import ArchiveError, load, model_names, save
from tests.archive import models, plain_digest
from tests.archive.plain_digest import attributes, instead, put, without
from tests.archive.test_layout import ATTRIBUTES, DATASETS, OPTIONAL, TEXT
from tests.errors.table import refused, says

NAME = "two_link_arm"
SEAL = 44  # bytes behind the HDF5 file
FIRST = Path(__file__).parent / "archive_1_0.h5"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """An archive with the arm, not to be changed."""
    file = tmp_path_factory.mktemp("written") / "arm.h5"
    save(file, models.arm())
    return file


@pytest.fixture
def file(written, tmp_path):
    """A copy of it, to be damaged."""
    return shutil.copy(written, tmp_path / "arm.h5")


def edit(file, change):
    plain_digest.edit(file, change, f"models/{NAME}")


# files --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", [0.0, 1e-4, 0.01, 0.1, 0.5, 0.9, 0.999])
def test_truncated(file, part):
    whole = file.read_bytes()[:-SEAL]
    cut = whole[: int(part * len(whole))]
    file.write_bytes(cut)
    message = f"{file}: is not a whole HDF5 file ({len(cut)} bytes): "
    advice = "Write it again, or take it from a backup."
    for attempt in (load, model_names, lambda path: save(path, models.arm())):
        with says(ArchiveError, message, advice):
            attempt(file)
    assert file.read_bytes() == cut


def test_last_byte_missing_and_text(file):
    whole = file.read_bytes()
    for cut in (1, SEAL):  # nothing of the model is there, and it is read in the other process
        file.write_bytes(whole[:-cut])
        models.same(load(file), models.arm())
    file.write_bytes(whole[: -SEAL - 1])
    with says(ArchiveError, f"is not a whole HDF5 file ({len(whole) - SEAL - 1} bytes): "):
        load(file)
    file.write_text("A = [0 1; -1 0]")
    with says(ArchiveError, "is not a whole HDF5 file (15 bytes): "):
        load(file)


def test_foreign(tmp_path):
    file = tmp_path / "foreign.h5"
    with h5py.File(file, "w") as archive:
        archive["models/arm/A"] = np.eye(2)
    before = file.read_bytes()
    message = (
        f"{file}: is not an mbdlft archive: root attribute 'format' is None, expected 'mbdlft-archive'."
    )
    for attempt in (load, model_names, lambda path: save(path, models.arm())):
        with says(ArchiveError, message):
            attempt(file)
    assert file.read_bytes() == before


@pytest.fixture
def kept(file):
    """What a file that is changed is refused for, by all that read it; nothing is written into it."""

    def refuse(change, *attempts):
        with h5py.File(file, "r+") as archive:
            change(archive)
        before = file.read_bytes()
        for attempt in attempts or (load, model_names, lambda path: save(path, models.arm())):
            with pytest.raises(ArchiveError) as caught:
                attempt(file)
            assert str(caught.value).startswith(f"{file}: ")
        assert file.read_bytes() == before
        raise caught.value

    return refuse


def test_bytes_that_are_damaged(file):
    """Reading a damaged file gives a model or an ArchiveError, whatever HDF5 itself would raise."""
    whole = file.read_bytes()
    random = np.random.default_rng(0)
    others = []
    for position in (*range(0, 1200, 22), *random.integers(0, len(whole), 50)):
        damaged = bytearray(whole)
        damaged[position] ^= 0xFF
        file.write_bytes(damaged)
        try:
            load(file)
        except ArchiveError:
            continue
        except Exception as error:
            others.append(f"byte {position}: {type(error).__name__}: {error}")
    assert not others, "\n".join(others)


@pytest.fixture
def damaged(file):
    """Reads the model after a change."""

    def read(change):
        edit(file, change)
        load(file)

    return read


test_messages = refused(
    r"""
> {load|model_names}({}) => ArchiveError:
tmp_path / "none.h5" => none.h5: cannot be read: No such file or directory.
tmp_path => : cannot be read: Is a directory.
> kept({}) => ArchiveError:
attributes("", format="other") => root attribute 'format' is 'other', expected 'mbdlft-archive'.
attributes("", format_version="2.0")
    => has format version 2.0, this mbdlft reads up to 1.1. Install a newer mbdlft.
attributes("", format_version="10.1") => has format version 10.1, this mbdlft reads up to 1.1.
attributes("", format_version="new") => 'format_version' is 'new', expected '1.1'.
attributes("", format_version=None) => 'format_version' is None, expected '1.1'.
instead("models", np.arange(3.0)) => models
without("models"), load => give the name of the model. Existing: none.
> kept(attributes(""), {}) => ArchiveError:
lambda file: load(file, "two_link_am")
    => unknown model 'two_link_am'. Did you mean 'two_link_arm'? Existing: two_link_arm.
lambda file: save(file, models.arm(), "{a/b|/|.}") => '{0}' cannot name a model
lambda file: save(file, models.arm(), "a\0b") => 'a\x00b' cannot name a model
lambda file: save(file, models.arm(), "a\ud800") => 'a\ud800' cannot name a model
lambda file: save(file, replace(models.arm(), description="a\0b")) => .h5:
# Models and places that cannot be written.
> save({}) => ArchiveError:
tmp_path / "none" / "arm.h5", models.arm()
    => arm.h5: cannot be written: No such file or directory. The old file, if there was one, is unchanged.
tmp_path, models.arm() => : cannot be read: Is a directory.
> damaged({}) => ArchiveError: model 'two_link_arm' …
attributes("certificate", exact=np.bool_(False), truncation_error=None)
    => is not whole: … 'truncation_error'
attributes("certificate", sign_changes=np.int64(1), condition=None)
    => is not whole: … 'condition' of 'certificate' is missing
attributes("", encoding_type="sweep") => encoding_type is 'sweep', expected 'lft-model' or 'system'.
attributes("", encoding_type=None) => encoding_type is '', expected 'lft-model' or 'system'.
attributes("", encoding_version="2.1") => encoding_version is 2.1, this mbdlft reads up to 1.1.
attributes("", encoding_version=None) => encoding_version
attributes("", time_domain="discrete") => time_domain
attributes("certificate", order_bound=3) => order_bound is 3, expected at least 16
instead("A", ["a", "b"]) => : A is text of variable length, expected
put("D_zw", (0, 0), {np.nan|np.inf}) => is not as specified: LFT: M11 has an entry that is not finite.
put("delta/parameter", [0, -1], {[1, 0]|[-1, 0]|[0, 7]})
    => delta/parameter is not sorted, or names a parameter that is not there
put("parameters/map", (0, 1), 3.0) => parameters/map of 'J1' is [ … ], but its range gives [
put("parameters/low", 0, 9.0) => is not as specified: parameter 'J1': low must be less than high
"""
)


def test_name_is_needed(file):
    save(file, models.arm(), "other")
    with says(ArchiveError, f"{file}: give the name of the model. Existing: other, two_link_arm."):
        load(file)


# models -------------------------------------------------------------------------------------------


# an exact model of the first files has no truncation_error
REQUIRED = [
    (group, name)
    for group in ("certificate", "provenance")
    for name in ATTRIBUTES[group]
    if name not in ("truncation_error", "scene", "condition", "sign_changes", "rounding_ratio")
]
PARTS = "states", "parameters", "delta", "trim", "certificate"
WHOLE = f"model '{NAME}' is not whole: "
DAMAGES = {
    **{f"no {k}": (without(k), (WHOLE, f"'{k}' is missing")) for k in DATASETS if k not in OPTIONAL},
    **{f"no {k}": (without(k), (WHOLE, f"'{k}/", "is missing")) for k in PARTS},
    **{f"no {g}.{k}": (attributes(g, **{k: None}), (WHOLE, f"'{k}'")) for g, k in REQUIRED},
}


@pytest.mark.parametrize(("change", "texts"), DAMAGES.values(), ids=DAMAGES.keys())
def test_a_model_that_is_damaged(file, change, texts):
    edit(file, change)
    with says(ArchiveError, *texts) as caught:
        load(file)
    assert str(caught.value).startswith(f"{file}: model '{NAME}'")


# a text may be longer; the digest would say so
SIZED = [name for name in DATASETS if name != "provenance/scene"]


@pytest.mark.parametrize("name", SIZED)
def test_dataset_with_one_entry_too_many(file, name):
    def change(group):
        value = group[name].asstr()[()] if DATASETS[name][0] == TEXT else group[name][()]
        del group[name]
        longer = np.concatenate([value, value[-1:]])
        longer = longer.astype("S") if longer.dtype == object else longer
        group.create_dataset(name, data=longer)

    edit(file, change)
    with says(ArchiveError, f"{file}: model '{NAME}'"):
        load(file)


@pytest.mark.parametrize("rows", [[1, 0, 6], [-1, 1, 6], [0, 1, 7]])
def test_rows_of_a_first_file_are_sorted_and_of_parameters(file, rows):
    """Files of 1.0 have nothing else that says to which parameter a channel belongs."""
    shutil.copy(FIRST, file)
    plain_digest.edit(file, put("delta/parameter", [0, 1, -1], rows), "models/turned_arm")
    with says(ArchiveError, "delta/parameter is not sorted, or names a parameter that is not there"):
        load(file, "turned_arm")


def test_each_bit_of_the_numbers(file):
    """One bit anywhere in the numbers of files of 1.0 is found: they have checksums."""
    shutil.copy(FIRST, file)
    name = "turned_arm"
    whole = file.read_bytes()
    places = []
    with h5py.File(file) as archive:
        archive["models"][name].visititems(
            lambda key, item: places.append((key, item)) if isinstance(item, h5py.Dataset) else None
        )
        numbers = [(key, item.id) for key, item in places if item.dtype.kind in "fi" and item.size]
        assert {"A", "B_w", "D_zw", "parameters/low", "certificate/order", "delta/parameter"} <= {
            key for key, _ in numbers
        }
        chunks = [
            (key, found.byte_offset, found.size)
            for key, item in numbers
            for found in map(item.get_chunk_info, range(item.get_num_chunks()))
        ]
    assert len(chunks) >= len(numbers)
    random = np.random.default_rng(0)
    for _, start, size in chunks:
        for bit in random.choice(8 * size, 3, replace=False):
            damaged = bytearray(whole)
            damaged[start + bit // 8] ^= 1 << (bit % 8)
            file.write_bytes(damaged)
            with says(ArchiveError, f"{file}: model '{name}' is damaged: ", "checksum"):
                load(file, name)
