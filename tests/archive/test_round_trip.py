"""What is written is what is read, bit for bit; and writing is repeatable."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from mbdlft import load, matrices_at, model_names, save, trim_at
from tests.apart import printed
from tests.archive import models
from tests.archive.models import contents, same
from tests.archive.plain_digest import edit, put_text
from tests.close import exact

BUILT = {
    "arm": models.arm,
    "turned arm": models.turned_arm,
    "a parameter with zero repetitions": models.unused,
    "no parameters": models.numbers,
    "all that is known of what is free": models.free,
}
MADE = {
    "bare": models.bare,
    "no blocks": lambda: models.strange(1, ()),
    "only empty blocks": lambda: models.strange(2, (0, 0)),
    "empty first and last": lambda: models.strange(3, (0, 2, 0)),
    "strange 4": lambda: models.strange(4),
    "strange 5": lambda: models.strange(5, (1, 4, 0, 2)),
}


@pytest.mark.parametrize("make", (BUILT | MADE).values(), ids=(BUILT | MADE).keys())
def test_round_trip(tmp_path, make):
    model = make()
    save(tmp_path / "a.h5", model)
    same(load(tmp_path / "a.h5"), model)
    same(load(str(tmp_path / "a.h5"), model.name), model)


def test_read_arrays_cannot_be_changed(tmp_path):
    save(tmp_path / "a.h5", models.arm())
    with pytest.raises(ValueError, match="read-only"):
        load(tmp_path / "a.h5").A[0, 0] = 1.0


@pytest.mark.parametrize("make", [models.arm, lambda: models.strange(4)], ids=["arm", "strange"])
def test_writing_twice_gives_equal_files(tmp_path, make):
    save(tmp_path / "a.h5", make())
    save(tmp_path / "b.h5", make())
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_writing_again_into_the_same_file_gives_equal_datasets(tmp_path):
    file = tmp_path / "a.h5"
    save(file, models.arm())
    before = contents(file)
    save(file, models.arm())
    assert contents(file) == before
    save(file, load(file))
    assert contents(file) == before
    save(file, replace(models.arm(), description="other"))
    assert contents(file) != before


def test_replacing_one_model_keeps_the_other(tmp_path):
    file = tmp_path / "a.h5"
    save(file, models.arm())
    save(file, models.strange(6), "second θ")
    kept = {key: value for key, value in contents(file).items() if "two_link_arm" in key}
    save(file, models.strange(7, (1,)), "second θ")
    same(load(file, "second θ"), replace(models.strange(7, (1,)), name="second θ"))
    after = {key: value for key, value in contents(file).items() if "two_link_arm" in key}
    assert after == kept
    same(load(file, "two_link_arm"), models.arm())
    assert model_names(file) == ("second θ", "two_link_arm")


def test_replacing_again_and_again_does_not_make_the_file_grow(tmp_path):
    file = tmp_path / "a.h5"
    save(file, models.arm())
    once = file.stat().st_size
    for _ in range(20):
        save(file, models.arm())
    assert file.stat().st_size < 2 * once


def test_what_mbdlft_does_not_know_stays(tmp_path):
    file = tmp_path / "a.h5"
    save(file, models.arm())
    with h5py.File(file, "r+") as archive:
        archive["sweeps/first/samples"] = np.arange(3.0)
        archive["sweeps/first"].attrs["note"] = np.arange(3)
        archive["sweeps"].attrs["note"] = "yours"
        archive.attrs["note"] = "mine"
        archive["other/words"] = ["of", "any length"]

    def change(group):
        group["cubic/name"] = np.array([b"cubic"])
        group["certificate"].attrs["fit_error_bound"] = 0.0

    edit(file, change, "models/two_link_arm")
    same(load(file), models.arm())
    save(file, models.strange(6))
    with h5py.File(file) as archive:
        exact(archive["sweeps/first/samples"][()], np.arange(3.0))
        exact(archive["sweeps/first"].attrs["note"], np.arange(3))
        assert archive.attrs["note"] == "mine"
        assert archive["sweeps"].attrs["note"] == "yours"
        assert list(archive["other/words"].asstr()) == ["of", "any length"]
        assert "cubic/name" in archive["models/two_link_arm"]
    same(load(file, "two_link_arm"), models.arm())


def test_later_minor_versions_are_read(tmp_path):
    file = tmp_path / "a.h5"
    save(file, models.arm())
    with h5py.File(file, "r+") as archive:
        put_text(archive, "format_version", "1.7")
    edit(file, lambda group: put_text(group, "encoding_version", "1.3"), "models/two_link_arm")
    same(load(file), models.arm())


@pytest.mark.parametrize("name", ["arm 2.0", "日本", "..", "a.b", "\\", "'", "a\nb"])
def test_names_of_models(tmp_path, name):
    save(tmp_path / "a.h5", models.arm(), name)
    assert model_names(tmp_path / "a.h5") == (name,)
    same(load(tmp_path / "a.h5", name), replace(models.arm(), name=name))


def test_map_of_another_machine(tmp_path):
    """A tangent may differ in its last bit on another processor; the archive is then still right."""
    file = tmp_path / "a.h5"
    save(file, models.arm())

    def change(group):
        parameters = group["parameters"]
        row = list(parameters["name"].asstr()[()]).index("theta1")
        parameters["map"][row, 1] = np.nextafter(parameters["map"][row, 1], np.inf)

    edit(file, change, "models/two_link_arm")
    assert load(file).name == "two_link_arm"


# Reading needs h5py and numpy only: everything else is blocked --------------------------------------

BLOCKED = (
    *("casadi", "control", "matplotlib", "pydantic", "rich"),
    *("scipy", "threadpoolctl", "tomli_w", "typer"),
)
PROGRAM = """
import json, sys, mbdlft

model = mbdlft.load(sys.argv[1])
matrices = mbdlft.matrices_at(model, {"m1": 2.6, "theta1": 50.0})
mbdlft.save(sys.argv[1] + ".copy", model)
response = mbdlft.frequency_response(model, mbdlft.random(model.parameters, 3), [1.0, 2.0])
print(json.dumps({"matrices": [m.tolist() for m in matrices], "shape": response.shape}))
for name in sys.argv[2].split(","):
    try:
        __import__(name)
    except ImportError as error:
        assert str(error) == f"{name} is blocked"
    else:
        raise AssertionError(name)
"""


def test_reading_with_everything_else_blocked(tmp_path):
    file = tmp_path / "a.h5"
    save(file, models.arm())
    answer = json.loads(printed(PROGRAM, file, ",".join(BLOCKED), without=BLOCKED))
    wanted = matrices_at(models.arm(), {"m1": 2.6, "theta1": 50.0})
    for found, matrix in zip(answer["matrices"], wanted, strict=True):
        exact(np.array(found), matrix)
    assert answer["shape"] == [3, 2, 2, 2]
    assert (tmp_path / "a.h5.copy").read_bytes() == file.read_bytes()
