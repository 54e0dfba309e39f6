"""Functional mock-up units against the library: FMPy validates, sets, gets and simulates them."""

import ctypes
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from zipfile import ZipFile

import fmpy
import fmpy.validation
import numpy as np
import pytest
from numpy.typing import ArrayLike

import mbdlft
from mbdlft import Block, Parameter
from mbdlft.export import export_model
from mbdlft.export.names import identifier
from mbdlft.lft import LFT
from mbdlft.system import System
from tests.close import exact, roundoff
from tests.exported import COMPILER, STRICT, exported, scenario

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler")
VERSIONS = pytest.mark.parametrize("version", [3, 2])


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> Callable[[System, int], Path]:
    """Units of models, each written once, without optimization, and valid."""
    folder = tmp_path_factory.mktemp("units")

    @cache
    def unit_of(model: System, version: int) -> Path:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("CFLAGS", "-O0")
            (file,) = export_model(folder / f"{model.name}{version}.fmu", model, fmi=version)
        assert fmpy.validation.validate_fmu(str(file)) == []
        return file

    return unit_of


def values_of(model: System) -> dict[str, float]:
    return {p.name: 0.3 * p.low + 0.7 * p.high for p in model.parameters}


@pytest.mark.parametrize(
    "stem",
    [
        "pendulum",
        *(
            pytest.param(s, marks=pytest.mark.long)
            for s in ("two_link_arm", "half_car", "rotatory_spacecraft")
        ),
    ],
)
@VERSIONS
def test_steps_of_co_simulation_are_exact(stem: str, version: int, units: Any) -> None:
    model = scenario(stem)
    values, step = values_of(model), model.inputs[0].name
    start = {f"parameter.{name}": value for name, value in values.items()} | {f"input.{step}": 1.0}
    names = [f"output.{s.name}" for s in model.outputs]
    rows = fmpy.simulate_fmu(
        str(units(model, version)), fmi_type="CoSimulation", stop_time=2.0,
        output_interval=0.04, start_values=start, output=names,
    )  # fmt: skip
    expected = mbdlft.analyze.step_response(model, values, rows["time"], inputs=[step]).values[0, :, :, 0]
    largest = np.max(np.abs(expected), axis=0)
    assert np.all(largest > 0.0)
    assert np.max(np.abs(np.stack([rows[name] for name in names], axis=1) - expected) / largest) < 1e-8


@pytest.fixture
def opened(units: Any, tmp_path: Path) -> Any:
    """Open a unit of a model, for model exchange unless a kind is given, in initialization mode."""

    def open_unit(model: System, version: int, kind: str = "ModelExchange") -> Any:
        file = units(model, version)
        folder = fmpy.extract(str(file), str(tmp_path / f"unit{version}"))
        description = fmpy.read_model_description(folder)
        unit = fmpy.instantiate_fmu(folder, description, kind)
        if version == 2:
            unit.setupExperiment()
        unit.enterInitializationMode()
        numbers = {v.name: v.valueReference for v in description.modelVariables}
        derivatives = [v for v in description.modelVariables if v.derivative is not None]
        assert len(derivatives) == len(model.states)
        assert all(v.name == f"der({v.derivative.name})" for v in derivatives)
        get = unit.getReal if version == 2 else unit.getFloat64
        put = unit.setReal if version == 2 else unit.setFloat64

        def read(kind: str, names: list[str]) -> np.ndarray:
            return np.array(get([numbers[kind.format(name)] for name in names]))

        def write(kind: str, values: dict[str, float]) -> None:
            put([numbers[kind.format(name)] for name in values], list(values.values()))

        def slope(unknowns: list[str], knowns: list[str], seed: ArrayLike) -> np.ndarray:
            at = [[numbers[name] for name in names] for names in (unknowns, knowns)]
            return np.array(unit.getDirectionalDerivative(*at, list(np.asarray(seed))))

        def call(function: str, *arguments: Any) -> None:
            getattr(unit, f"fmi{version}{function}")(unit.component, *arguments)

        return SimpleNamespace(unit=unit, read=read, write=write, slope=slope, call=call)

    return open_unit


@VERSIONS
def test_rates_outputs_and_slopes_are_those_of_the_matrices(opened: Any, version: int) -> None:
    model = scenario("pendulum")
    at, fmu = values_of(model), opened(model, version)
    x, u, y = ([s.name for s in getattr(model, key)] for key in ("states", "inputs", "outputs"))
    generator = np.random.default_rng(3)
    states, inputs = generator.standard_normal(len(x)), generator.standard_normal(len(u))
    fmu.write("parameter.{}", at)
    fmu.write("state.{}", dict(zip(x, states, strict=True)))
    fmu.write("input.{}", dict(zip(u, inputs, strict=True)))
    A, B, C, D = mbdlft.matrices_at(model, at)
    roundoff(fmu.read("der(state.{})", x), A @ states + B @ inputs, 100.0)
    roundoff(fmu.read("output.{}", y), C @ states + D @ inputs, 100.0)
    roundoff(fmu.read("trim.{}", [s.name for s in model.trim.signals]), mbdlft.trim_at(model, at), 100.0)
    rows = [*(f"der(state.{name})" for name in x), *(f"output.{name}" for name in y)]
    columns = [*(f"state.{name}" for name in x), *(f"input.{name}" for name in u)]
    seed = np.concatenate([states, inputs])
    roundoff(fmu.slope(rows, columns, seed), np.block([[A, B], [C, D]]) @ seed, 100.0)


@cache
def stiff() -> System:
    """f' = 1e6 (s - f), s' = -s/100 + u, g' = g + a - 1; texts have what XML does not allow."""
    A = np.diag([-1e6, -0.01, 1.0])
    A[0, 1] = 1e6
    direct = np.vstack([np.column_stack([A, [0.0, 1.0, 0.0]]), [0.0, 0.0, 1.0, 0.0]])
    column = np.array([[0.0], [0.0], [1.0], [0.0]])
    lft = LFT([[0.0]], [[0.0, 0.0, 1.0, 0.0]], column, direct, (Block("a", 1),))
    f, s, g, u, y = (mbdlft.Signal(name, "furlong\x02" if name == "y" else "1") for name in "fsguy")
    parameters = (Parameter("a", 0.0, -0.5, 0.5),)
    return System("stiff", lft, (f, s, g), (u,), (y,), parameters, description="a <b>\x00\x01\nc")


def check_stiff(fmu: Any, t: float, u: float, kappa: float) -> None:
    """States from ones, after f has settled, each against its closed form."""
    moving = (1.0 - 100.0 * u) * np.exp(-0.01 * t)
    expected = [moving * 1e6 / (1e6 - 0.01) + 100.0 * u, moving + 100.0 * u, np.exp(t)]
    roundoff(fmu.read("state.{}", ["f", "s", "g"]) / expected, np.ones(3), kappa)


@VERSIONS
def test_steps_keep_digits_of_slow_poles_beside_fast_ones(opened: Any, version: int) -> None:
    """Long steps, and many short ones; where a state overflows there is an error, and it stays."""
    fmu = opened(stiff(), version, "CoSimulation")
    fmu.write("state.{}", dict.fromkeys("fsg", 1.0))
    fmu.write("input.{}", {"u": 0.3})
    fmu.unit.exitInitializationMode()
    fmu.unit.doStep(0.0, 50.0)
    check_stiff(fmu, 50.0, 0.3, 50.0)
    for step in (1000.0, 0.0, -1.0, np.nan, np.inf):
        with pytest.raises(Exception, match="fmi"):
            fmu.unit.doStep(50.0, step)
    check_stiff(fmu, 50.0, 0.3, 50.0)
    fmu.write("state.{}", dict.fromkeys("fsg", 1.0))
    count, step = 4000, 1.3e-6
    for k in range(count):
        fmu.unit.doStep(k * step, step)
    check_stiff(fmu, count * step, 0.3, 1.0)


@VERSIONS
def test_units_refuse_what_they_do_not_have(opened: Any, version: int) -> None:
    """Slopes by parameters and of numbers that no variable has; another number of states."""
    fmu, numbers = opened(stiff(), version), (ctypes.c_double * 8)()
    exact(fmu.slope(["der(state.g)", "output.y", "state.f"], ["state.g"], [2.0]), [2.0, 2.0, 0.0])
    for unknown, known in (("output.y", "parameter.a"), ("der(state.g)", "parameter.a")):
        with pytest.raises(Exception, match="fmi"):
            fmu.slope([unknown], [known], [1.0])
    for unknown, known in ((99, 99), (99, 2), (2, 99)):
        with pytest.raises(Exception, match="fmi"):
            fmu.unit.getDirectionalDerivative([unknown], [known], [1.0])
    rates = "GetDerivatives" if version == 2 else "GetContinuousStateDerivatives"
    sizes = dict.fromkeys(("GetContinuousStates", rates, "GetNominalsOfContinuousStates"), 3)
    for function, size in {**sizes, "SetContinuousStates": 3, "GetEventIndicators": 0}.items():
        fmu.call(function, numbers, size)
        for other in {0, 2, 4} - {size}:
            with pytest.raises(Exception, match="fmi"):
                fmu.call(function, numbers, other)


@VERSIONS
def test_states_of_units_are_saved_and_parameters_outside_are_refused(opened: Any, version: int) -> None:
    model = scenario("pendulum")
    fmu, (first, *_) = opened(model, version), model.states
    fmu.write("state.{}", {first.name: 2.0})
    get, put = ((fmu.unit.getFMUstate, fmu.unit.setFMUstate) if version == 2 else
                (fmu.unit.getFMUState, fmu.unit.setFMUState))  # fmt: skip
    saved = get()
    fmu.write("state.{}", {first.name: 3.0})
    put(saved)
    exact(fmu.read("state.{}", [first.name]), [2.0])
    parameter = model.parameters[0]
    fmu.write("parameter.{}", {parameter.name: 2.0 * parameter.high + 1.0})
    with pytest.raises(Exception, match="fmi"):
        fmu.read("output.{}", [model.outputs[0].name])


@VERSIONS
@pytest.mark.parametrize("key", ["bare", pytest.param("system", marks=pytest.mark.long)])
def test_models_without_states_or_signals(key: str, version: int, units: Any, tmp_path: Path) -> None:
    """Their C has no warning."""
    model = exported(key)
    with ZipFile(units(model, version)) as archive:
        archive.extractall(tmp_path)
        (binary,) = [name for name in archive.namelist() if name.startswith("binaries/")]
    command = [
        "cc",
        *STRICT,
        "-Wno-type-limits",
        "-Wno-unused-parameter",
        "-O0",
        "-fsyntax-only",
        "fmu.c",
    ]
    done = subprocess.run(command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert Path(binary).stem == identifier(model.name)
    assert ctypes.CDLL(str(tmp_path / binary))
