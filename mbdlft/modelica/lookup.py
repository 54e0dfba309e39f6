"""Tables of the library (CombiTimeTable, CombiTable1D) whose numbers stand in the model.

The library keeps them in external objects and looks values up in external code; here a table is a record
of what it was made of, and a value is an expression: lines between points, or steps that hold from
their point on. A point is a switch like that of any `if`: an equilibrium on it needs equal slopes on both
sides.
"""

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from itertools import pairwise

from mbdlft.base.errors import SceneError
from mbdlft.dae.theta.piecewise import joined
from mbdlft.modelica import tree
from mbdlft.modelica import values as v
from mbdlft.modelica.values import Value

_OBJECTS = "Modelica.Blocks.Types.External"
_INTERNAL = "Modelica.Blocks.Tables.Internal.get"
OF_TIME = f"{_INTERNAL}TimeTableValue"  # begins the names of functions that look up a time
_FIRST, _LAST = ("Tmin", "Umin"), ("Tmax", "Umax")
_LINES, _STEPS = "LinearSegments", "ConstantSegments"
_HOLD, _ON, _PERIODIC = "HoldLastPoint", "LastTwoPoints", "Periodic"
Points = Sequence[tuple[Fraction, Fraction]]


def of_tables(name: str, function: tree.Function) -> Callable[..., Value] | None:
    """What a function of the library's tables gives of its arguments; None for any other function."""
    kind = name.removeprefix(f"{_OBJECTS}Combi")
    if kind in ("TimeTable", "Table1D"):
        return partial(_table, kind, [d.name for d in function.inputs])
    what = name.removeprefix(_INTERNAL)
    if what == name or not what.startswith(("TimeTable", "Table1D")):
        return None
    if what.endswith((*_FIRST, *_LAST)):
        return partial(_end, 0 if what.endswith(_FIRST) else -1)
    return _of_time if what.startswith("Time") else _of_one


def _table(kind: str, names: Sequence[str], *arguments: Value) -> Value:
    """The record of a table: its arguments by name, with the rows as numbers."""
    table = dict(zip(names, arguments, strict=False))
    if table.get("tableName") != "NoName" or table.get("fileName") != "NoName":
        raise SceneError("a table of a file is not supported; write its numbers into the model.")
    if table["smoothness"] not in (_LINES, _STEPS):
        raise SceneError(
            f"a table with smoothness {table['smoothness']} is not supported; known are {_LINES} and "
            f"{_STEPS}."
        )
    beyond = (_HOLD, _ON) if table["smoothness"] == _LINES else (_HOLD,)
    if kind == "TimeTable":
        beyond = (*beyond, _PERIODIC)
    if table["extrapolation"] not in beyond:
        raise SceneError(
            f"a table with {table['smoothness']} and extrapolation {table['extrapolation']} is not "
            f"supported; known is {', '.join(beyond)}."
        )
    table["table"] = tuple(tuple(map(_number, row)) for row in table["table"])
    _check(table["table"], strictly=kind != "TimeTable")
    return table


def _number(entry: Value) -> Fraction:
    number = v.number_of(entry)
    if number is None:
        raise SceneError(
            f"an entry of a table is {v.described(entry)}; expected a number. Keep it a number."
        )
    return number


def _check(rows: Sequence[tuple[Fraction, ...]], *, strictly: bool) -> None:
    """Raise a SceneError unless there are points, and they increase."""
    if not rows:
        raise SceneError("a table has no rows.")
    for (a, *_), (b, *_) in pairwise(rows):
        if not (a < b if strictly else a <= b):
            raise SceneError(f"the points of a table do not increase: {float(a):g}, {float(b):g}.")


def _end(place: int, table: Mapping[str, Value]) -> Value:
    """The first or the last point."""
    return table["table"][place][0]


def _of_one(table: Mapping[str, Value], column: Value, u: Value) -> Value:
    position = int(table["columns"][int(column) - 1]) - 1
    return _value(table, [(row[0], row[position]) for row in table["table"]], u)


def _of_time(table: Mapping[str, Value], column: Value, time: Value, *_: Value) -> Value:
    """Zero before the start; a periodic table is one of the time since its period began."""
    u = v.binary("-", time, table["shiftTime"])
    first, last = table["table"][0][0], table["table"][-1][0]
    if table["extrapolation"] == _PERIODIC and first < last:
        periods = v.binary("/", v.binary("-", u, first), last - first)
        number = v.number_of(periods)
        whole = v.to_sx(periods).floor() if number is None else Fraction(number // 1)
        u = v.binary("-", u, v.binary("*", whole, last - first))
    value = _of_one(table, column, u)
    before = v.binary("<", time, table["startTime"])
    if isinstance(before, bool):
        return Fraction(0) if before else value
    return v.chosen(before, Fraction(0), value)


def _value(table: Mapping[str, Value], points: Points, u: Value) -> Value:
    """The value of a table through points."""
    on = table["extrapolation"] == _ON
    if table["smoothness"] == _STEPS:
        cuts, pieces = [b for b, _ in points[1:]], [value for _, value in points]
    else:
        cuts, pieces = _lines(points, u, on=on)
    number = v.number_of(u)
    if number is not None:
        return pieces[bisect_right(cuts, number)]
    return joined(v.to_sx(u), [v.to_sx(cut) for cut in cuts], [v.to_sx(piece) for piece in pieces])


def _lines(points: Points, u: Value, *, on: bool) -> tuple[list[Fraction], list[Value]]:
    """Ends of lines, and these, with those beyond: held, or going `on`; two points in one are a jump."""
    cuts, lines = [], []
    for (a, low), (b, high) in pairwise(points):
        if a < b:
            slope = v.binary("/", v.binary("-", high, low), b - a)
            lines.append(v.binary("+", low, v.binary("*", slope, v.binary("-", u, a))))
            cuts.append(a)
    if not lines:
        return [], [points[-1][1]]
    if on:
        return cuts[1:], lines
    return [*cuts, points[-1][0]], [points[0][1], *lines, points[-1][1]]
