"""Models as objects of CasADi, python-control and xarray, against the library's own numbers."""

from pathlib import Path

import casadi as ca
import numpy as np

import mbdlft
from mbdlft.export import casadi_function, dataset, frequency_data
from tests.archive.models import arm
from tests.close import exact, roundoff
from tests.exported import samples_of

OMEGA = np.logspace(-1.0, 2.0, 7)


def test_casadi_function_has_the_matrices_and_their_slopes() -> None:
    model = arm()
    function = casadi_function(model)
    values, matrices = samples_of(model)
    for k in range(0, len(matrices[0]), 20):
        found = function(**{name: column[k] for name, column in values.items()})
        for key, expected in zip("ABCD", matrices, strict=True):
            roundoff(np.array(found[key]), expected[k], model.certificate.condition)
    exact(np.array(function()["A"]), np.array(function(*(p.nominal for p in model.parameters))[0]))
    area = [mbdlft.Parameter("A", 2.0, percent=20)]
    of_area = casadi_function(mbdlft.realize([["3*A"]], area, inputs=["u"], outputs=["y"]))
    exact(np.array(of_area(A=2.25)["D"]), [[6.75]])
    for word in ("end", "null", "jac"):  # of MATLAB, and of CasADi itself
        named = casadi_function(mbdlft.as_system(model, name=word))
        exact(np.array(named()["A"]), np.array(function()["A"]))
    m3 = ca.MX.sym("m3")
    slope = ca.Function("slope", [m3], [ca.jacobian(function(m3=m3)["A"], m3)])
    at, h = model.parameters["m3"].nominal, 1e-4
    ahead, behind = (mbdlft.matrices_at(model, {"m3": at + step}).A for step in (h, -h))
    difference = (ahead - behind).T.ravel() / (2.0 * h)
    assert np.max(np.abs(np.array(slope(at)).ravel() - difference)) < 1e-7 * np.max(np.abs(difference))


def test_frequency_data_and_datasets_have_names_and_numbers() -> None:
    model = arm()
    values = mbdlft.random(model.parameters, 3, seed=2)
    responses = mbdlft.frequency_response(model, values, OMEGA)
    systems = frequency_data(model, values, OMEGA)
    data = dataset(model, values, OMEGA)
    for k, system in enumerate(systems):
        exact(np.moveaxis(system.frdata, -1, 0), responses[k])
        assert system.output_labels == [s.name.replace(".", "_") for s in model.outputs]
    exact(data.response.values, responses)
    y, u = model.outputs[1].name, model.inputs[0].name
    exact(data.response.sel(output=y, input=u).values, responses[:, :, 1, 0])
    for key, matrix in zip("ABCD", mbdlft.matrices_at(model, values), strict=True):
        exact(data[key].values, matrix)
    for p in model.parameters:
        exact(data[p.name].values, values[p.name])
        assert data[p.name].attrs["units"] == p.unit
    assert list(data.input_unit.values) == [s.unit for s in model.inputs]
    assert "response" not in dataset(model)


def test_datasets_of_sweeps(tmp_path: Path) -> None:
    model = arm()
    file = tmp_path / "arm.h5"
    mbdlft.sweep(model, mbdlft.random(model.parameters, 4, seed=3), file, poles=True)
    rows = mbdlft.load_sweep(file)
    data = dataset(rows)
    for key in ("A", "B", "C", "D", "trim", "poles", "status", "residual"):
        exact(data[key].values, getattr(rows, key))
    exact(data["m3"].values, rows.samples[:, [p.name for p in rows.layout.parameters].index("m3")])
    assert list(data.trimmed.values) == [s.name for s in rows.layout.trim]
