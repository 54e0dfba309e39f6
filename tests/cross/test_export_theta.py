"""Exported Delta-Theta forms against the library: compiled C and m-files in Octave."""

import ctypes
import subprocess
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.io import savemat

import mbdlft
from mbdlft.base import StructureError
from mbdlft.base.errors import MbdlftError
from mbdlft.dae import Dae, DaeDraft, evaluate_form
from mbdlft.export import export_model
from mbdlft.export.names import identifier
from mbdlft.pipeline import delta_theta
from mbdlft.system import DeltaThetaModel
from tests.close import EXPORT, target
from tests.daes import dae_of, example_1, example_2, pendulum, servo
from tests.exported import COMPILER, OCTAVE, STRICT, compiled, pointer, read
from tests.modelica import flat
from tests.seeds import some

COUNT = 12


def zoo() -> Dae:
    """Many functions, tables of both kinds inside of others, loops through Theta, a constant."""
    d = DaeDraft("zoo")
    p = d.parameter(mbdlft.Parameter("p", 2.0, percent=10))
    x, v, end = (d.variable("x", start=0.3), d.variable("v"), d.variable("end", minimum=-50, maximum=50))
    w, u = d.variable("w", start=0.1), d.input("u")
    b = [-2.0, -0.5, 0.25, 1.0, 3.0]
    cubic = d.table(x, b, [1.0, 0.5, 0.75, 2.0, 1.5], "cubic")
    line = d.table(v, b, [0.0, 0.3, -0.4, 1.0, 5.0], beyond="constant")
    d.equation(d.der(x), equals=v - p * cubic * x + ca.sin(line) + 1)
    d.equation(d.der(v), equals=u - ca.exp(-x * x) * v - ca.atan2(v, 2 + x * x) + p * end)
    d.equation(w + p * ca.tanh(w) + w**3 / 4, "loop", equals=x + ca.sin(v))
    other = ca.if_else(ca.logic_or(x > 0.1, v < -1), ca.fmin(x, v), ca.sqrt(1 + v * v))
    more = ca.log1p(x * x) + ca.fmod(x * v - 5, 2) + ca.floor(v) + ca.hypot(x, 1 + v) + ca.sign(v)
    d.equation(end, equals=ca.copysign(1.5, v) * ca.asinh(x) + other + more + ca.cosh(w))
    d.output("x")
    d.output("power", w * v + p * u)
    return d.dae()


MODELS = {
    "example_1": example_1,
    "example_2": example_2,
    "servo": servo,
    "pendulum": lambda: pendulum(0.4),
    "zoo": zoo,
    "aircraft": lambda: flat("aircraft_longitudinal")[0],
}


@cache
def form(name: str) -> DeltaThetaModel:
    return delta_theta(MODELS[name](), search=0.0, prove=0.0)


def samples(model: DeltaThetaModel) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """States, inputs, parameters, and rates and outputs that the library finds there."""
    drawn = np.random.default_rng(5)
    states, inputs = [s.name for s in model.linear.states], [s.name for s in model.inputs]
    parameters = model.linear.parameters
    rows = []
    for _ in range(COUNT):
        x = np.array(model.initial) + 0.05 * drawn.uniform(-1, 1, len(states)) * (
            1 + np.abs(model.initial)
        )
        u = drawn.uniform(-1, 1, len(inputs))
        p = np.array([drawn.uniform(q.low, q.high) for q in parameters])
        rates, y = evaluate_form(
            model,
            dict(zip(states, x, strict=True)),
            dict(zip(inputs, u, strict=True)),
            dict(zip(parameters.names, p, strict=True)),
        )
        rows.append((x, u, p, [*rates.values()], [*y.values()]))
    x, u, p, rates, y = (np.array(part, dtype=float) for part in zip(*rows, strict=True))
    return x, u, p, [rates, y]


@pytest.mark.parametrize("name", some(["pendulum", "zoo"], MODELS))
def test_derivatives_in_c(name: str, tmp_path: Path) -> None:
    model = form(name)
    library = compiled(model, tmp_path)
    derivative = getattr(library, f"{identifier(model.name)}_derivative")
    x, u, p, expected = samples(model)
    found = [np.full_like(part, np.nan) for part in expected]
    zeta = np.array(model.zeta_at_start)
    for k in range(COUNT):
        given = [np.ascontiguousarray(part[k]) for part in (p, x, u)]
        near = pointer(zeta) if k % 2 else None
        assert derivative(*map(pointer, given), near, *(pointer(part[k]) for part in found)) == 0
    for part, wanted in zip(found, expected, strict=True):
        target(part, wanted, EXPORT)
    start = (ctypes.c_double * len(x[0])).in_dll(library, f"{identifier(model.name)}_initial")
    target(np.array(start), model.initial, EXPORT)


def theta_of(model: DeltaThetaModel, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values of Theta by the library, and their slopes by differences."""

    def values(omega: np.ndarray) -> np.ndarray:
        found = mbdlft.theta_values(model.functions, dict(zip(model.omega, omega, strict=True)))
        return np.array([*found.values()]).ravel()

    steps = 1e-6 * np.eye(len(omega))
    return values(omega), np.array([(values(omega + e) - values(omega - e)) / 2e-6 for e in steps]).T


def test_slopes_of_theta_in_c_are_those_of_differences(tmp_path: Path) -> None:
    model = form("zoo")
    theta = compiled(model, tmp_path).zoo_theta
    drawn = np.random.default_rng(3)
    for _ in range(20):
        omega = drawn.uniform(-1.5, 1.5, len(model.omega))
        zeta, slopes = np.zeros(len(model.functions)), np.zeros((len(model.functions), len(omega)))
        assert theta(pointer(omega), pointer(zeta), pointer(slopes)) == 0
        values, differences = theta_of(model, omega)
        target(zeta, values, EXPORT)
        target(slopes, differences, 1e-6, 10.0)


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler cc")
def test_c_says_what_is_outside(tmp_path: Path) -> None:
    model = form("servo")
    limits = {"minimum": -1, "maximum": 1}
    dae = dae_of("bounded", "x", "der(x) = u - sinh(x)", inputs="u", outputs="x", **limits)
    model = delta_theta(dae, search=0.0)
    derivative = compiled(model, tmp_path).bounded_derivative
    u, rates = np.zeros(1), np.full(1, 7.0)
    for at, status in ((0.5, 0), (1.5, 3), (np.nan, 4)):
        rates[:] = 7.0
        got = derivative(None, pointer(np.array([at])), pointer(u), None, pointer(rates), None)
        assert got == status
        target(rates, [-np.sinh(0.5) if not status else 7.0], EXPORT)


PROGRAM = """
s = load('samples.mat');
for k = 1:size(s.x, 1)
  values = struct();
  for j = 1:numel(s.names), values.(s.names{j}) = s.p(k, j); end
  [rates(k, :), y(k, :), zeta] = m_rates(s.x(k, :)', s.u(k, :)', values);
end
a = single(s.x(1, :)'); b = single(s.u(1, :)');
singles = isequal(m_rates(a, b), m_rates(double(a), double(b)));
m; model = load('m.mat'); [z, S] = m_rates(s.omega');
message = '';
try, m_rates(1e9 * ones(1, numel(model.theta.initial)), s.u(1, :)', values);
catch e, message = e.message; end
clear s model values plant e;
save('-v6', 'found.mat');
"""


@pytest.mark.skipif(OCTAVE is None, reason="there is no octave-cli")
@pytest.mark.parametrize("name", ["example_2", "pendulum", "zoo"])
def test_derivatives_in_octave(name: str, tmp_path: Path) -> None:
    model = form(name)
    files = export_model(tmp_path / "m.mat", model)
    assert [file.name for file in files] == ["m.mat", "m.m", "m_at.m", "m_rates.m"]
    x, u, p, expected = samples(model)
    names = read(tmp_path / "m.mat")["parameters"]["identifier"]
    omega = np.random.default_rng(3).uniform(-1.5, 1.5, len(model.omega))
    savemat(tmp_path / "samples.mat", {"x": x, "u": u, "p": p, "names": names, "omega": omega})
    (tmp_path / "run_it.m").write_text(PROGRAM, encoding="utf-8")
    command = [str(OCTAVE), "--quiet", "--norc", "--no-gui", "run_it.m"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (tmp_path / "found.mat").exists(), done.stderr
    found = read(tmp_path / "found.mat")
    target(found["rates"], expected[0], EXPORT)
    target(found["y"], expected[1], EXPORT)
    values, differences = theta_of(model, omega)
    target(found["z"].ravel(), values, EXPORT)
    target(found["S"].reshape(differences.shape), differences, 1e-6, 10.0)
    assert found["singles"]  # numbers of other types are doubles
    if name == "zoo":
        assert "Theta" in str(found["message"])


def test_a_script_of_julia_calls_the_c_beside_it(tmp_path: Path) -> None:
    model = form("zoo")
    script, source, header, archive = export_model(tmp_path / "zoo.jl", model)
    text = script.read_text(encoding="utf-8")
    for function in ("zoo_theta", "zoo_derivative"):
        declared = header.read_text(encoding="utf-8").partition(f"int {function}(")[2].partition(")")[0]
        called = text.partition(f"ccall((:{function}, LIBRARY), Cint,")[2].partition("))")[0]
        assert called.count("Ptr{Cdouble}") == declared.count("double *")
    c = [path.read_bytes() for path in export_model(tmp_path / "zoo.c", model)]
    assert [source.read_bytes(), header.read_bytes()] == c
    assert f'joinpath(@__DIR__, "{source.name}")' in text
    assert text.count("(") == text.count(")")
    assert text.count("[") == text.count("]")
    assert mbdlft.load(archive).functions == model.functions


def test_what_cannot_be_exported(tmp_path: Path) -> None:
    with pytest.raises(StructureError, match="has nonlinear functions"):
        export_model(tmp_path / "a.npz", form("zoo"), 3)
    linear = delta_theta(dae_of("linear", "x", "der(x) = -x", outputs="x"), search=0.0)
    for suffix in ("c", "mat", "jl"):
        with pytest.raises(MbdlftError, match=r"no nonlinear functions. Export model.linear"):
            export_model(tmp_path / f"a.{suffix}", linear)
    assert not list(tmp_path.iterdir())
    assert STRICT
