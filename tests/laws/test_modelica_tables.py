"""Laws of the tables of the Modelica library, as records and values of them."""

from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest

from mbdlft.base.errors import SceneError
from mbdlft.modelica import tree
from mbdlft.modelica.lookup import of_tables
from mbdlft.problem.sx.constants import in_doubles
from tests.close import exact, roundoff

ROWS = ((0, 1, 5), (2, -3, 5), (3, 4, 6), (7, 0, 2))
TIMES = np.linspace(-4.3, 12.9, 87)
NAMES = {
    "TimeTable": "tableName fileName table startTime columns smoothness extrapolation shiftTime",
    "Table1D": "tableName fileName table columns smoothness extrapolation",
}


def function(name: str, inputs: str = "") -> tree.Function:
    return tree.Function(name, tuple(tree.Declaration(n, "Real", 0) for n in inputs.split()), (), (), ())


def table(
    kind: str, smoothness: str, extrapolation: str, rows: Any = ROWS, start: Any = 0, shift: Any = 0
) -> Any:
    values = {
        **dict.fromkeys(("tableName", "fileName"), "NoName"),
        "table": tuple(tuple(map(Fraction, row)) for row in rows),
        **{"startTime": Fraction(start), "shiftTime": Fraction(shift)},
        "columns": (Fraction(2), Fraction(3)),
        **{"smoothness": smoothness, "extrapolation": extrapolation},
    }
    name = f"Modelica.Blocks.Types.ExternalCombi{kind}"
    make = of_tables(name, function(name, NAMES[kind]))
    assert make is not None
    return make(*(values[key] for key in NAMES[kind].split()))


def got(kind: str, of: Any, column: int, at: float) -> tuple[float, float]:
    """The value at a number, and that of the expression of a symbol."""
    name = f"Modelica.Blocks.Tables.Internal.get{kind}Value"
    look = of_tables(name, function(name))
    assert look is not None
    u = ca.SX.sym("u")
    number, expression = (look(of, Fraction(column), x) for x in (Fraction(at), u))
    return float(number), float(ca.Function("f", [u], [in_doubles(expression)])(at))


@pytest.mark.parametrize("column", [1, 2])
def test_lines_are_those_of_numpy_and_go_on_with_the_last_slopes(column: int) -> None:
    x, y = np.array(ROWS, dtype=float)[:, (0, column)].T
    held, on = (table("Table1D", "LinearSegments", e) for e in ("HoldLastPoint", "LastTwoPoints"))
    for u in TIMES:
        expected = np.interp(u, x, y)
        roundoff(got("Table1D", held, column, u), [expected] * 2)
        k = 0 if u < x[0] else len(x) - 2
        if not x[0] <= u <= x[-1]:
            expected = y[k] + (y[k + 1] - y[k]) / (x[k + 1] - x[k]) * (u - x[k])
        roundoff(got("Table1D", on, column, u), [expected] * 2)


def test_steps_of_time_begin_at_their_points_shifted_and_after_the_start() -> None:
    held = table("TimeTable", "ConstantSegments", "HoldLastPoint", start="-1", shift="0.5")
    again = table("TimeTable", "ConstantSegments", "Periodic", start="-1000")
    x, y = np.array(ROWS, dtype=float)[:, :2].T
    for t in TIMES:
        step = y[max(np.searchsorted(x, t - 0.5, side="right") - 1, 0)]
        exact(got("TimeTable", held, 1, t), [step if t >= -1.0 else 0.0] * 2)
        exact(got("TimeTable", again, 1, t), [y[np.searchsorted(x, t % 7.0, side="right") - 1]] * 2)


def test_two_points_of_one_time_are_a_jump_to_the_second() -> None:
    jump = table("TimeTable", "LinearSegments", "HoldLastPoint", ((0, 1), (1, 3), (1, 7), (2, 7)))
    exact([got("TimeTable", jump, 1, t) for t in (0.5, 1.0, 1.5)], [[2.0] * 2, [7.0] * 2, [7.0] * 2])


def test_ends_are_those_of_the_rows() -> None:
    of = table("Table1D", "LinearSegments", "HoldLastPoint")
    for name, end in (("Table1DAbscissaUmin", 0), ("Table1DAbscissaUmax", 7)):
        whole = f"Modelica.Blocks.Tables.Internal.get{name}"
        look = of_tables(whole, function(whole))
        assert look is not None
        assert look(of) == end


@pytest.mark.parametrize(
    ("kind", "smoothness", "extrapolation", "rows", "reason"),
    [
        ("Table1D", "ContinuousDerivative", "HoldLastPoint", ROWS, "ContinuousDerivative"),
        ("Table1D", "ConstantSegments", "LastTwoPoints", ROWS, "known is HoldLastPoint"),
        ("Table1D", "LinearSegments", "Periodic", ROWS, "Periodic"),
        ("Table1D", "LinearSegments", "HoldLastPoint", ((0, 1, 1), (0, 2, 2)), "increase: 0, 0"),
        ("TimeTable", "LinearSegments", "HoldLastPoint", ((1, 1, 1), (0, 2, 2)), "increase: 1, 0"),
        ("Table1D", "LinearSegments", "HoldLastPoint", (), "no rows"),
    ],
)
def test_what_is_no_table_of_lines_or_steps_is_refused(
    kind: str, smoothness: str, extrapolation: str, rows: Any, reason: str
) -> None:
    with pytest.raises(SceneError, match=reason):
        table(kind, smoothness, extrapolation, rows)
