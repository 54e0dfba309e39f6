"""Every Modelica scenario runs: it is read, linearized, certified, and simulated in both forms."""

from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft.dae import simulate
from mbdlft.modelica import operating_point, structure_of
from mbdlft.pipeline.dae_models import delta_theta, linearize_dae
from tests.close import SCENARIO, SIMULATED, target
from tests.modelica import FLAT, ROOT, SCENARIOS, flat
from tests.scenarios.commands import Output

NAMES = [file.stem for file in SCENARIOS]
# time (s) that shows what moves, and steps of the inputs
MOTIONS = {
    "aircraft_longitudinal": (4.0, (0.01, 50.0)),
    "block_diagram": (4.0, (1.0,)),
    "buck_converter": (2e-3, (0.02, 1.0)),
    "cartesian_pendulum": (2.0, (1.0,)),
    "coupled_inertias": (4.0, (5.0,)),
    "hydraulic_servo": (0.2, (0.5, 100.0)),
    "motor_drive": (0.5, (6.0,)),
    "nonlinear_spring": (4.0, (30.0,)),
    "thermal_network": (2000.0, (10.0, 5.0)),
}


def test_all_scenarios_have_flat_texts_and_are_simulated() -> None:
    assert sorted(MOTIONS) == NAMES
    assert len(NAMES) == 9
    page = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    for name in NAMES:
        assert (FLAT / f"{name}.mof").exists()
        assert f"`{name}`" in page


@pytest.mark.parametrize("name", NAMES)
def test_linear_models_are_exact(name: str) -> None:
    dae, report, table = flat(name)
    assert dae.description
    assert not report.notes
    model = linearize_dae(operating_point(dae, report, table), search=0.0, prove=0.0)
    assert model.certificate.exact
    assert model.certificate.max_relative_error <= SCENARIO
    assert model.certificate.check_points >= 100
    assert len(model.parameters) >= 1


@pytest.mark.parametrize("count", [2, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", NAMES)
def test_functions_beside_the_linear_part_give_the_same_motion(name: str, count: int) -> None:
    dae, report, table = flat(name)
    structure = structure_of(dae, report, table)
    form = delta_theta(structure, search=0.0, prove=0.0)
    length, steps = MOTIONS[name]
    times = np.linspace(0.0, length, 11)
    inputs = {
        q.name: (q.variable.start or 0.0) + step * np.cos(np.arange(11.0))
        for q, step in zip(structure.inputs, steps, strict=True)
    }
    drawn = mbdlft.random(dae.parameters, count, 7)
    initial = dict(zip([q.name for q in structure.states], form.initial, strict=True))
    for sample in range(count):
        parameters = {key: float(values[sample]) for key, values in drawn.items()}
        a, b = (
            simulate(one, times, inputs=inputs, parameters=parameters, initial=initial)
            for one in (structure, form)
        )
        for k in range(a.outputs.shape[1]):
            assert np.ptp(a.outputs[:, k]) > 0.0
            target(b.outputs[:, k], a.outputs[:, k], SIMULATED)


def test_commands(tmp_path: Path, output: Output) -> None:
    flat_file, archive = str(FLAT / "thermal_network.mof"), tmp_path / "box.h5"
    table = str(ROOT / "scenarios" / "modelica" / "thermal_network.toml")
    out = output("check", flat_file, "--parameters", table, "--model", "ThermalNetwork")
    assert "ThermalNetwork: 26 equations, 2 inputs, 3 parameters left in" in out
    assert "index 1" in out
    assert "found" in next(line for line in out.splitlines() if "│ Q " in line)
    out = output("linearize", flat_file, "--parameters", table, "-o", str(archive))
    assert "minimal: proved" in out
    assert mbdlft.load(archive).order == 3
    varied = ["--vary", "rotor.J=20%", "--vary", "c=50:80"]
    out = output("linearize", str(FLAT / "motor_drive.mof"), *varied, "-o", str(archive), "--search", "0")
    ranges = {p.name: (p.low, p.high) for p in mbdlft.load(archive, "MotorDrive").parameters}
    assert ranges["c"] == (50, 80)
    target(ranges["rotor_J"], (1.6e-4, 2.4e-4), SCENARIO)
    assert "no equilibrium: der(" in output("check", str(FLAT / "oscillator.mof"), "--at", "start")
    out = output("linearize", str(FLAT / "coupled_inertias.mof"), "--search", "0")
    assert "against the nonlinear equations, linearized with numbers" in out
    assert "First: poles at nominal" in output("poles", str(FLAT / "first.mof"))
    out = output("check", str(FLAT / "first.mof"))
    assert "note: sine.y is a function of time: it is an input" in out
