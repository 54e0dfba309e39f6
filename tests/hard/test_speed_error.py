"""The benchmark of speed and error at its smallest: verified answers, JSON lines, table and figure."""

import json
from collections.abc import Iterable
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eig, matrix_balance

from benchmarks import speed_error
from benchmarks.speed import truth as truth_module
from benchmarks.speed.formulas import SlowError, by_sympy, limited
from benchmarks.speed.methods import CANDIDATES, Candidate
from benchmarks.speed.motion import Circle, Link, Mass, chain_motion, state_space
from benchmarks.speed.own import by_lft
from benchmarks.speed.picture import STYLES, figure
from benchmarks.speed.robots import Method
from benchmarks.speed.systems import System, systems
from benchmarks.speed.truth import entry_errors, pole_errors, truth
from benchmarks.speed_error import Row, groups, json_lines, measured, table
from tests.close import CLOSED_FORM, EVALUATION, exact, poles_by_qr, roundoff, target

try:
    distribution("example-robot-data")
except PackageNotFoundError:
    pytest.skip("the robot is not installed: pip install -e '.[robots]'", allow_module_level=True)

# other tools are imported here, old ones beside new ones
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

SAMPLES = 300
SYSTEMS = {system.name: system for system in systems()}
SMALL = ("two-link arm", "flexible satellite")  # rigid links, and beams, which some methods have not
SLOW = {  # seconds to prepare; the arm has them
    ("flexible satellite", name)
    for name in ("plain C", "vectorized C", "grid, quadratic", "mbdlft, LFT compiled")
}


def quick(system: str) -> list[Candidate]:
    return [c for c in CANDIDATES if c.name != "grid, cubic" and (system, c.name) not in SLOW]


def rows_of(systems: Iterable[str]) -> list[Row]:
    return [row for name in systems for row in measured(SYSTEMS[name], SAMPLES, 1, 1, quick(name))]


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return rows_of(SMALL)


def test_every_method_has_a_row_for_every_system(rows: list[Row]) -> None:
    law_rows(rows, SMALL)


@pytest.mark.long
def test_large_systems_have_rows_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"{__name__}.SLOW", {("UR5", "SymPy")})
    found = rows_of(SYSTEMS)
    law_rows(found, SYSTEMS)
    law_exact(found)


def law_rows(rows: list[Row], systems: Iterable[str]) -> None:
    assert [(r["system"], r["method"]) for r in rows] == [
        (system, c.name) for system in systems for c in quick(system)
    ]
    for row in rows:
        if "error" in row:
            assert 0.0 < row["error_median"] <= row["error"]
            assert row["seconds_per_model"] > 0.0
            assert row["build_seconds"] >= 0.0
        else:
            assert row["reason"]


def test_exact_methods_are_exact(rows: list[Row]) -> None:
    law_exact(rows)


def law_exact(rows: list[Row]) -> None:
    """Chains of rigid links to rounding; the satellite has entries over many decades."""
    for row in rows:
        exact_one = row["method"].split(",")[0] not in ("MuJoCo", "grid")
        if exact_one and "error" in row and row["system"] != "flexible satellite":
            assert row["error"] <= CLOSED_FORM, row
    arm = next(row for row in rows if row["method"] == "mbdlft, LFT")
    assert arm["error"] <= EVALUATION


@pytest.mark.parametrize("module", ["pinocchio", "mujoco", "pydrake", "sympy"])
def test_what_is_installed_is_compared(rows: list[Row], module: str) -> None:
    pytest.importorskip(module)
    names = [c.name for c in CANDIDATES if c.module == module]
    found = [row for row in rows if row["method"] in names and row["system"] == "two-link arm"]
    assert len(found) == len(names) > 0
    assert all("error" in row for row in found)


def test_what_cannot_be_done_says_why(rows: list[Row], monkeypatch: pytest.MonkeyPatch) -> None:
    flexible = {r["method"]: r for r in rows if r["system"] == "flexible satellite"}
    assert flexible["pinocchio"]["reason"] == "no beams among its bodies"
    monkeypatch.setattr("benchmarks.speed.methods.find_spec", lambda name: None)
    (row,) = measured(SYSTEMS["UR5"], 3, 1, 1, [c for c in CANDIDATES if c.name == "Drake"])
    assert row["reason"] == "not installed"


def test_lines_table_and_figure(rows: list[Row], tmp_path: Path) -> None:
    assert [json.loads(line) for line in json_lines(rows).splitlines()] == rows
    text = table(rows)
    assert text.count("\n| two-link arm |") == len(quick("two-link arm")) + 1
    assert "target 1 us" in text
    assert set(STYLES) == {c.name for c in CANDIDATES}
    figure(tmp_path / "figure.png", groups(rows))
    assert (tmp_path / "figure.png").stat().st_size > 0


def test_a_wrong_method_is_not_timed() -> None:
    """Planted bug: one part in a million."""

    def wrong(system: System) -> Method:
        method = by_lft(system)
        return lambda samples: tuple(1.000001 * part for part in method(samples))

    with pytest.raises(SystemExit, match="bad is wrong"):
        measured(SYSTEMS["two-link arm"], 20, 1, 1, [Candidate("bad", wrong)])


def test_a_tool_that_is_faster_and_more_accurate_is_named() -> None:
    own: Row = {"method": "mbdlft, LFT", "error": 1e-15, "seconds_per_model": 1e-6}
    own |= {"system": "s", "pole_error": 3e-15, "pole_rounding": 1e-15}
    better = own | {"method": "Drake", "error": 5e-16, "seconds_per_model": 5e-7}
    exact(speed_error.beaten([own, better], ["mbdlft, LFT"]), ["Drake"])
    for key in ("error", "seconds_per_model"):
        exact(speed_error.beaten([own, better | {key: own[key]}], ["mbdlft, LFT"]), [])
    exact(speed_error.beaten([own, better | {"method": "plain C"}], ["mbdlft, LFT"]), [])
    poles = better | {"error": own["error"], "pole_error": 1e-15}
    exact(speed_error.beaten([own, poles], ["mbdlft, LFT"]), ["Drake"])
    exact(speed_error.beaten([own, poles | {"pole_error": 2.5e-15}], ["mbdlft, LFT"]), [])


def test_80_bits_that_are_64_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: numbers with the digits of float, where more are promised."""
    system = SYSTEMS["UR5"]
    monkeypatch.setattr(truth_module, "LONG", np.float64)
    with pytest.raises(AssertionError, match="no more digits"):
        truth(system, system.samples(3), 1)


def test_a_wrong_formula_is_seen_with_50_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: 80 bits of another stiffness than the 50 digits."""
    system = SYSTEMS["two-link arm"]
    long = truth_module._long

    def wrong(*given: object) -> tuple[np.ndarray, int]:
        values, n = long(*given)
        values[:, 2, 0] *= 1.0 + 1e-13
        return values, n

    monkeypatch.setattr(truth_module, "_long", wrong)
    with pytest.raises(AssertionError, match="80 bits differ"):
        truth(system, system.samples(3), 1)


def test_errors_of_entries_and_poles_are_those_that_are_made() -> None:
    system = SYSTEMS["spatial chain of 4"]
    found = truth(system, system.samples(5), 1)
    values = found.values.astype(float)
    sizes = np.max(np.abs(values), axis=0)
    values[3, 6, 2] += 1e-6 * sizes[6, 2]
    errors = entry_errors(values, found)
    assert int(np.argmax(errors)) == 3
    roundoff(errors[3], 1e-6, kappa=1e6)
    A = values[:, : found.states, : found.states]
    poles = np.linalg.eigvals(A)
    for k, missed in enumerate(pole_errors(poles, found)):
        even = matrix_balance(A[k])[0]
        size, left, right = eig(even, left=True, right=True)
        errors = 2.0 * np.abs(size) * poles_by_qr(even, left, right) / np.max(np.abs(size)) ** 2
        if k != 3:  # of squares
            target(missed, 0.0, float(np.max(errors)), scale=1.0)
    assert np.all(found.rightmost >= 0.0)
    scaled = replace(found, squares=found.squares * 1.01)
    roundoff(pole_errors(poles, scaled)[:3], 0.01 / 1.01 * np.ones(3), kappa=1e2)


def test_a_pendulum_by_hand() -> None:
    """m L^2 qddot = m g L sin q of a point mass at angle q from the horizontal, about x."""
    q, m, length = 0.4, 2.0, 0.7
    link = Link((0, 0, 0), "x", q, (Mass(m, (0, length, 0)),))
    rows = state_space(chain_motion([link], Circle(np.cos, np.sin)))
    expected = [[0, 1, 0], [9.81 / length * np.sin(q), 0, 1 / (m * length**2)], [1, 0, 0]]
    roundoff(np.array(rows, dtype=float), expected)


def test_what_takes_too_long_is_interrupted() -> None:
    pytest.importorskip("sympy")
    with pytest.raises(SlowError):
        by_sympy(SYSTEMS["UR5"], seconds=1e-3)
    with limited(60.0):
        assert find_spec("mbdlft")
