"""Nonlinear functions in archives: read without CasADi, and refused where they do not agree."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import ArchiveError
from mbdlft.dae import DaeDraft, formula_function
from mbdlft.pipeline import delta_theta
from tests.archive.plain_digest import edit, instead, without
from tests.close import CLOSED_FORM, target
from tests.daes import example_2
from tests.scenarios.commands import run

READER = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("casadi", "scipy", "flint", "pydantic"):
            raise ImportError(name)

sys.meta_path.insert(0, Blocked())
import mbdlft
model = mbdlft.load(sys.argv[1])
omega = {name: [0.3, -0.2] for name in model.omega}
for name, values in mbdlft.theta_values(model.functions, omega).items():
    print(name, *values)
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    mbdlft.save(tmp_path / "a.h5", delta_theta(example_2(), "blocks", search=0.0))
    return tmp_path / "a.h5"


def test_functions_are_read_and_evaluated_without_casadi(file: Path) -> None:
    command = [sys.executable, "-c", READER, str(file)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    found = {line.split()[0]: np.array(line.split()[1:], float) for line in result.stdout.splitlines()}
    model = delta_theta(example_2(), "blocks", search=0.0)
    for f in model.functions:
        own = formula_function("f", f.arguments, f.text)
        expected = [float(own(*[x] * len(f.arguments))) for x in (0.3, -0.2)]
        target(found[f.name], expected, CLOSED_FORM)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("count", np.array([1, 1]), "theta/count"),
        ("count", np.array([0, 4]), "theta/count"),
        ("text", np.array([b"__import__('os')", b"1"]), "is not allowed"),
        ("signal", np.array([b"x", b"y", b"z", b"w"]), "unknown output 'x'"),
        ("name", np.array([b"f", b"f"]), "stands twice"),
        ("name", np.array([b"f", b"g"]), "unknown input 'f'"),
        ("low", np.array([np.inf] * 4), "theta/low"),
        ("initial", np.zeros(3), "theta/initial"),
        ("unit", None, "theta/unit"),
    ],
)
def test_what_does_not_agree(file: Path, name: str, value: object, message: str) -> None:
    change = without(f"theta/{name}") if value is None else instead(f"theta/{name}", value)
    edit(file, change, "models/example_2")
    with pytest.raises(ArchiveError, match=message):
        mbdlft.load(file)


def test_commands_show_functions_and_do_not_leave_them_out(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    for command in ("show", "poles", "margin"):
        code, out, err = run(monkeypatch, capsys, command, str(file))
        if command == "show":
            assert code == 0
            assert "theta.spring.alpha(J1_phi, J2_phi) = (J1_phi - J2_phi)**2" in out
        else:
            assert code == 2
            assert "has 2 nonlinear functions, and is not linear" in err


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("tables", np.array([2]), "theta/tables: expected 1 together"),
        ("table/count", np.array([3]), "theta/table/count: expected 4 together"),
        ("table/pairs", np.array([2]), "theta/table/pairs: expected 3 together"),
        ("table/breakpoint", np.array([0.0, 1.0, 1.0, 2.0]), "number 1: the breakpoints .* increase"),
        ("table/value", np.array([0.0, np.nan, 1.0, 2.0]), "not finite"),
        ("table/slope", np.zeros((3, 3)), "theta/table/slope"),
        ("table/below", None, "theta/table/below"),
    ],
)
def test_tables_that_do_not_agree(tmp_path: Path, name: str, value: object, message: str) -> None:
    d = DaeDraft("curve")
    x = d.variable("x")
    d.equation(d.der(x), equals=-d.table(x, [0, 1, 2, 3], [0, 2, 3, 7], "cubic"))
    d.output("x")
    mbdlft.save(tmp_path / "a.h5", delta_theta(d.dae(), search=0.0))

    change = without(f"theta/{name}") if value is None else instead(f"theta/{name}", value)
    edit(tmp_path / "a.h5", change, "models/curve")
    with pytest.raises(ArchiveError, match=message):
        mbdlft.load(tmp_path / "a.h5")
