"""Matrices on a grid in files of other tools, and the Julia script, against the library."""

import csv
import io
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdlft
from mbdlft.export import export_model, lpv_grid
from tests.close import EXPORT, exact, target
from tests.exported import exported, read, texts

COUNTS = {"theta1": 3, "m3": 4}  # in the order of the names: m3, then theta1


def expected(counts: dict[str, int]) -> tuple[dict[str, np.ndarray], list[np.ndarray]]:
    model = exported("arm")
    values = mbdlft.grid(model.parameters, counts)
    return values, list(mbdlft.matrices_at(model, values))


def test_state_spaces_on_a_grid() -> None:
    model = exported("arm")
    values, matrices = expected(COUNTS)
    found = lpv_grid(model, COUNTS)
    assert len(found) == 12
    for k, system in enumerate(found):
        for letter, array in zip("ABCD", matrices, strict=True):
            exact(getattr(system, letter), array[k])
        at = model.at({name: float(column[k]) for name, column in values.items()})
        target(system.A, at.A, EXPORT)
        assert (system.input_labels, system.output_labels) == (at.input_labels, at.output_labels)
        assert system.state_labels == at.state_labels
    assert len(lpv_grid(exported("off_center"), 2)) == 8
    (single,) = lpv_grid(exported("numbers"), 9)
    exact(single.A, exported("numbers").A)


def test_grid_as_a_table(tmp_path: Path) -> None:
    model = exported("arm")
    (file,) = export_model(tmp_path / "grid.csv", model, COUNTS)
    values, matrices = expected(COUNTS)
    names, *rows = csv.reader(io.StringIO(file.read_text(encoding="utf-8")))
    table = dict(zip(names, np.array(rows, dtype=float).T, strict=True))
    for name, column in values.items():
        exact(table[name], column)
    exact(table["A_3_2"], matrices[0][:, 2, 1])
    exact(table["B_4_1"], matrices[1][:, 3, 0])
    exact(table["C_2_2"], matrices[2][:, 1, 1])
    assert isinstance(model, mbdlft.LFTModel)
    exact(table["elbow.torque"], mbdlft.trim_at(model, values)[:, 1])
    assert len(names) == 7 + 16 + 8 + 8 + 4 + 2


def test_grid_for_numpy(tmp_path: Path) -> None:
    model = exported("arm")
    (file,) = export_model(tmp_path / "grid.npz", model, COUNTS)
    values, matrices = expected(COUNTS)
    with np.load(file) as found:  # nothing is pickled
        assert list(found["parameters"]) == list(values)
        exact(found["values"], np.stack(list(values.values()), axis=1))
        exact(found["counts"], [1, 1, 1, 4, 1, 3, 1])
        for letter, array in zip("ABCD", matrices, strict=True):
            exact(found[letter], array)
        assert list(found["states"]) == [s.name for s in model.states]
        assert list(found["input_units"]) == [s.unit for s in model.inputs]
        assert found["trim"].shape == (12, 2)
        assert list(found["trimmed"]) == ["shoulder.torque", "elbow.torque"]


def test_grid_for_matlab_has_an_axis_for_each_parameter(tmp_path: Path) -> None:
    model = exported("arm")
    (file,) = export_model(tmp_path / "grid.mat", model, COUNTS)
    _, matrices = expected(COUNTS)
    found = read(file)
    assert texts(found["parameters"]["identifier"]) == list(model.parameters.names)
    exact(found["parameters"]["count"].ravel(), [1, 1, 1, 4, 1, 3, 1])
    shape = (1, 1, 1, 4, 1, 3, 1)
    assert found["A"].shape == (4, 4, *shape)
    for k in range(4):
        for j in range(3):
            values = {"m3": found["axes"]["m3"][k, 0], "theta1": found["axes"]["theta1"][j, 0]}
            at = mbdlft.matrices_at(model, values)
            target(found["A"][:, :, 0, 0, 0, k, 0, j, 0], at.A, EXPORT)
            target(found["B"][:, :, 0, 0, 0, k, 0, j, 0], at.B, EXPORT)
            assert isinstance(model, mbdlft.LFTModel)
            trim = mbdlft.trim_at(model, values)
            target(found["trim"]["value"][:, 0, 0, 0, k, 0, j, 0], trim, EXPORT)
    exact(found["B"][:, :, 0, 0, 0, 1, 0, 2, 0], matrices[1][1 * 3 + 2])


@pytest.mark.parametrize("suffix", [".mat", ".csv", ".npz"])
@pytest.mark.parametrize("key", ["numbers", "bare", "off_center", "system"])
def test_grids_of_models_of_all_kinds(key: str, suffix: str, tmp_path: Path) -> None:
    (file,) = export_model(tmp_path / f"grid{suffix}", exported(key), 2)
    assert file.stat().st_size > 0
    if suffix == ".csv":
        lines = file.read_text(encoding="utf-8").splitlines()
        assert len(lines) == 1 + 2 ** len(exported(key).parameters)


def test_julia_script_reads_what_an_archive_has(tmp_path: Path) -> None:
    model = exported("turned")
    script, archive = export_model(tmp_path / "arm.jl", model)
    assert archive == tmp_path / "arm.h5"
    assert mbdlft.load(archive).name == model.name
    text = script.read_text(encoding="utf-8")
    assert 'ARCHIVE = normpath(joinpath(@__DIR__, "arm.h5"))' in text
    assert f'MODEL = "{model.name}"' in text
    assert text.count("\nend") == text.count("\nfunction ")
    with h5py.File(archive) as file:
        group = file["models"][model.name]
        for name in re.findall(r'group\["([\w/]+)"\]', text):
            assert name in group or name in group["parameters"], name
        for name in re.findall(r'texts\(group, "(\w+)"\)', text):
            assert name in group["parameters"], name
        for name in re.findall(r'static\["([\w/]+)"\]', text):
            assert name in group["trim/lft"], name
        rows = group["delta/parameter"][()]
        blocks = [p.name for p in model.parameters for _ in range(dict(model.lft.blocks)[p.name])]
        assert [model.parameters.names[row] for row in rows] == blocks
    elsewhere = tmp_path / "scripts"
    elsewhere.mkdir()
    (script,) = export_model(elsewhere / "other.jl", model, archive=archive)
    assert 'joinpath(@__DIR__, "../arm.h5")' in script.read_text(encoding="utf-8")
