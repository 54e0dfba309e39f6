"""One fold, a table for each number system: it knows an operation of CasADi, or refuses it by name."""

from collections.abc import Callable
from pathlib import Path

import casadi as ca
import flint
import numpy as np
import pytest

import mbdlft
from mbdlft import Parameter
from mbdlft.base.errors import NotRationalError
from mbdlft.base.expression import evaluate, parse
from mbdlft.base.parameter import to_delta
from mbdlft.batch.rows import source_of
from mbdlft.exact import interval, taylor
from mbdlft.exact.interval import Interval
from mbdlft.exact.numbers import BITS, precision
from mbdlft.exact.rounding import cleaned
from mbdlft.lft.sampling import evaluate as evaluate_text
from mbdlft.matrix.relations import matrix_problem
from mbdlft.multibody.equilibrium.branches import _ARRAYS
from mbdlft.pipeline.extract.graph import reduced, walk
from mbdlft.problem import digits
from mbdlft.problem.relations import LinearModel
from mbdlft.problem.sx import tapes
from mbdlft.problem.sx.tapes import MANY, arithmetic, evaluate_many, fold, rules, steps, vectors
from tests.close import EPS, exact, roundoff
from tests.extracted import extracted

NAMES = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}
RATIONAL = {"OP_ADD", "OP_SUB", "OP_MUL", "OP_DIV", "OP_NEG", "OP_TWICE", "OP_SQ", "OP_INV"}
TRIGONOMETRIC = {"OP_SQRT", "OP_SIN", "OP_COS", "OP_TAN"}


def elementary() -> dict[str, ca.Function]:
    """A function (x, y) of one operation for each that an SX can have."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    found = {"OP_CONSTPOW": ca.Function("f", [x, y], [x**2.5])}
    for code, name in NAMES.items():
        if name not in ("OP_INPUT", "OP_OUTPUT", "OP_CONST"):
            function = ca.Function("f", [x, y], [ca.SX.binary(code, x, y)])
            if code in [function.instruction_id(k) for k in range(function.n_instructions())]:
                found[name] = function
    return found


OPERATIONS = elementary()


def point_of(function: ca.Function) -> tuple[float, float]:
    """Where the function is defined."""
    return (0.3, 0.7) if np.isfinite(float(function(0.3, 0.7))) else (1.3, 0.7)


def of_arrays(function: ca.Function, x: float, y: float) -> None:
    (found,) = fold(function, _ARRAYS, [np.full(3, x)], [np.full(3, y)])[0]
    roundoff(found, np.full(3, float(function(x, y))))


def of_program(function: ca.Function, x: float, y: float) -> None:
    if vectors(function) is None:
        raise NotRationalError(f"{', '.join(NAMES[step] for step in ids(function))}: no program")
    (found,) = evaluate_many(function, np.full((MANY, 1), x), np.full((MANY, 1), y))
    roundoff(found[:, 0, 0], np.full(MANY, float(function(x, y))))


def ids(function: ca.Function) -> list[int]:
    return [function.instruction_id(k) for k in range(function.n_instructions())]


def of_sizes(function: ca.Function, x: float, y: float) -> None:
    """A size is at least that of the value, and that of the value where nothing cancels."""
    (size,) = tapes.term_sizes(function, np.array([[x]]), np.array([[y]]))[0]
    value = abs(float(function(x, y)))
    if ca.OP_SUB in ids(function):
        roundoff(size, x + y)
    else:
        roundoff(size, value)


def of_intervals(function: ca.Function, x: float, y: float) -> None:
    table = arithmetic(Interval.of, interval.FUNCTIONS)
    (found,) = fold(function, table, [Interval(x, x)], [Interval(y, y)])[0]
    value = float(function(x, y))
    assert found.low <= value <= found.high
    roundoff([found.low, found.high], [value, value])


def of_taylor_models(function: ca.Function, x: float, y: float) -> None:
    monomials = taylor.space(1, 2)

    def number(value: float) -> taylor.Taylor:
        return taylor.constant(monomials, value, 1)

    table = arithmetic(number, taylor.FUNCTIONS)
    (found,) = fold(function, table, [number(x)], [number(y)])[0]
    value = float(function(x, y))
    assert abs(found.c[0, 0] - value) <= found.r[0] + EPS * abs(value)
    roundoff(found.c[0, 0], value)


def of_graphs(function: ca.Function, x: float, y: float) -> None:
    """The operation on two parameters is what a signal is multiplied with."""
    p, s = ca.SX.sym("p", 2), ca.SX.sym("s")
    (value,) = function.call([p[0], p[1]])
    graph = walk(ca.Function("f", [s, p], [value * s]), ["x", "y"])
    maps = [mbdlft.Parameter("p", at, 0.5 * at, 2.0 * at).map for at in (x, y)]
    with precision(BITS):
        found = reduced(graph, ["x", "y"], maps).closed().lft.rounded()
    roundoff(found.M22, [[float(function(x, y))]])


def of_texts(function: ca.Function, x: float, y: float) -> None:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    parameters = [mbdlft.Parameter(name, 1.0, 0.5, 2.0) for name in "ab"]
    problem = matrix_problem(function(a, b), parameters)
    found = evaluate(parse(problem.matrix[0][0]), {"a": x, "b": y})
    roundoff(found, float(function(x, y)))


LOGICAL = {f"OP_{name}" for name in ("LT", "LE", "EQ", "NE", "NOT", "AND", "OR", "IF_ELSE_ZERO")}
NOT_IN_NUMPY = {"OP_ERF", "OP_ERFINV", "OP_REMAINDER", "OP_FMOD", "OP_PRINTME"}
OF_DOUBLES = set(OPERATIONS) - LOGICAL - NOT_IN_NUMPY
TABLES: dict[str, tuple[Callable[[ca.Function, float, float], None], set[str]]] = {
    "arrays": (of_arrays, OF_DOUBLES),
    "sizes": (of_sizes, OF_DOUBLES),
    "program": (of_program, RATIONAL | TRIGONOMETRIC - {"OP_TAN"} | {"OP_FABS"}),
    "intervals": (of_intervals, RATIONAL | TRIGONOMETRIC | {"OP_ATAN", "OP_FABS", "OP_FMIN", "OP_FMAX"}),
    "Taylor models": (of_taylor_models, RATIONAL | TRIGONOMETRIC),
    "graphs": (of_graphs, RATIONAL),
    "texts": (of_texts, RATIONAL),
}


@pytest.mark.parametrize("name", OPERATIONS)
@pytest.mark.parametrize("table", TABLES)
def test_each_operation_is_known_or_refused(table: str, name: str) -> None:
    check, known = TABLES[table]
    function = OPERATIONS[name]
    if name in known:
        check(function, *point_of(function))
        return
    with pytest.raises(NotRationalError, match=f"(?i)({name}|{name[3:]} is not|exponent 2.5)"):
        check(function, 0.3, 0.7)


def test_sizes_go_through_functions() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    entries = ca.vertcat(1.0 / (x - y), 2.0 * ca.sqrt(x - y), ca.tan(x), ca.fabs(x - y), 7.0)
    function = ca.Function("f", [x, y], [entries])
    found = tapes.term_sizes(function, np.array([[3.0], [5.0]]), np.array([[1.0], [1.0]]))
    roundoff(found[0], [4.0 / 2.0**2, 2.0 * 2.0, -np.tan(3.0), 4.0, 7.0])
    roundoff(found[1], [6.0 / 4.0**2, 2.0 * np.sqrt(6.0), -np.tan(5.0), 6.0, 7.0])


@pytest.mark.parametrize("turns", [2, 12, 40])
def test_sizes_do_not_grow_along_frames_that_turn(turns: int) -> None:
    """Turned forth, a vector keeps its entries; turned back, what differs from it is rounding."""
    random, angle = np.random.default_rng(turns), ca.SX.sym("angle")
    start = ca.SX([0.3, -0.7, 0.6])
    axes = random.uniform(-1.0, 1.0, (turns, 3))
    moves = [(ca.SX(a / np.linalg.norm(a)), c * angle) for a, c in zip(axes, axes[:, 0], strict=True)]

    def turned(v: ca.SX, a: ca.SX, by: ca.SX) -> ca.SX:
        across = ca.cross(a, v)
        return v + ca.sin(by) * across + (1.0 - ca.cos(by)) * ca.cross(a, across)

    forth = start
    for move in moves:
        forth = turned(forth, *move)
    back = forth
    for a, by in reversed(moves):
        back = turned(back, a, -by)
    function = ca.Function("f", [angle], [ca.vertcat(forth, back - start)])
    points = np.array([[2.0], [0.7]])
    values, sizes = tapes.evaluate_many(function, points)[0][:, :, 0], tapes.term_sizes(function, points)
    assert np.all(sizes < 1000.0 + 100.0 * turns)
    np.testing.assert_array_equal(cleaned(values, sizes)[:, :3], values[:, :3])
    np.testing.assert_array_equal(cleaned(values, sizes)[:, 3:], 0.0)


def test_a_new_number_system_is_a_table() -> None:
    """Degrees of products: constants have none, sums the larger one."""
    table = rules(lambda value: 0, add=max, mul=lambda a, b: a + b, div=lambda a, b: a + b)
    x = ca.SX.sym("x", 2)
    entries = ca.vertcat(x[0] ** 3 * x[1] - 2 * x[0], 1 / (x[0] + x[1] ** 2), 7.0, -x[1])
    assert fold(ca.Function("f", [x], [entries]), table, [1, 1]) == [[4, 2, 0, 1]]


def test_structural_zeros_are_left_out() -> None:
    x = ca.SX.sym("x", 2)
    sparse = ca.diag(x)
    exact(fold(ca.Function("f", [x], [sparse, x[1]]), _ARRAYS, [2.0, 3.0])[0], [2.0, 3.0])


def test_instructions_are_read_once() -> None:
    function = OPERATIONS["OP_ADD"]
    fold(function, _ARRAYS, [1.0], [2.0])
    before = steps.cache_info()
    fold(function, _ARRAYS, [1.0], [2.0])
    after = steps.cache_info()
    assert (after.misses, after.hits) == (before.misses, before.hits + 1)


# Values at many points are those of the function at each --------------------------------------------

SCENARIOS = Path(__file__).parents[2] / "scenarios"
COUNT = 3 * tapes.MANY


def operations() -> ca.Function:
    """All operations that have a program, results of two shapes, constants and zeros among them."""
    a, b = ca.SX.sym("a", 3), ca.SX.sym("b", 2)
    first = ca.vertcat(a[0] * b[0] - a[1], ca.sin(a[2]) / a[0], ca.sqrt(a[0] + 2.0) + ca.cos(b[1]))
    second = ca.SX.zeros(2, 3)
    second[0, 1] = -ca.fabs(a[2]) + a[1] ** 2
    second[1, 0] = 1.0 / (a[0] + 3.0) + 2.0 * b[1]
    second[1, 1] = 7.5
    second[1, 2] = b[0]
    return ca.Function("f", [a, b], [first, ca.densify(second)])


def points() -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(5)
    return generator.uniform(0.5, 2.0, (COUNT, 3)), generator.uniform(-1.0, 1.0, (COUNT, 2))


def called(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    each = [[part.full() for part in function.call([x[k] for x in arguments])] for k in range(COUNT)]
    return [np.stack(parts) for parts in zip(*each, strict=True)]


def test_vectors_are_calls() -> None:
    function, arguments = operations(), points()
    assert tapes.vectors(function) is not None
    found = tapes.evaluate_many(function, *arguments)
    for part, expected in zip(found, called(function, *arguments), strict=True):
        roundoff(part, expected)


def test_few_points_are_calls() -> None:
    function, arguments = operations(), points()
    for count in (5, 1, 0):
        few = tapes.evaluate_many(function, *(x[:count] for x in arguments))
        for part, expected in zip(few, called(function, *arguments), strict=True):
            exact(part, expected[:count])


@pytest.mark.parametrize("near", [1, 2**17])
def test_chunks_are_parts(near: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tapes, "_NEAR", near)
    function, arguments = operations(), points()
    whole = tapes.evaluate_many(function, *arguments)
    seen = 0
    for part, values in tapes.evaluate_in_chunks(function, *arguments):
        assert part.start == seen
        seen = part.stop
        for value, expected in zip(values, whole, strict=True):
            exact(value, expected[part])
    assert seen == COUNT


def test_an_operation_without_a_program_is_called() -> None:
    a = ca.SX.sym("a", 1)
    function = ca.Function("f", [a], [ca.atan(a)])
    assert tapes.vectors(function) is None
    x = np.linspace(0.0, 1.0, COUNT)[:, None]
    roundoff(tapes.evaluate_many(function, x)[0][:, 0], np.arctan(x))
    ((part, (values,)),) = tapes.evaluate_in_chunks(function, x)
    assert part == slice(0, COUNT)
    roundoff(values[:, 0], np.arctan(x))


def test_a_long_function_is_called(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tapes, "_LONGEST", 3)
    assert tapes.vectors(operations()) is None


@pytest.mark.parametrize("name", ["two_link_arm", "solar_arrays"])
def test_linearizations_are_those_of_calls(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where accelerations are imposed, which one equation alone gives."""
    source = source_of(mbdlft.load_scene(SCENARIOS / f"{name}.toml"))
    samples = mbdlft.random(source.parameters, tapes.MANY + 1, seed=2)
    at = np.stack([samples[p.name] for p in source.parameters], axis=-1)
    found = source.rows(at)
    monkeypatch.setattr(tapes, "MANY", len(at) + 1)
    for part, expected in zip(found, source.rows(at), strict=True):
        roundoff(part, expected)


def test_functions_in_digits() -> None:
    """Functions, switches and kinks of balls are those of doubles."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    chosen = [ca.if_else(c, ca.exp(x), y) for c in (x < y, x <= y, x == y, x != y, x > y)]
    logic = [ca.logic_or(x < y, x == y), ca.logic_and(x < y, x >= y), ca.logic_not(x < y)]
    kinks = [ca.sign(x), ca.fabs(x), ca.fmin(x, y), ca.fmax(x, y)]
    powers = [y**x, ca.log(y), ca.tanh(x), ca.asin(x), ca.acos(x), ca.atan(x), ca.log1p(x), ca.sinh(x)]
    function = ca.Function("f", [x, y], [ca.vertcat(*chosen, *logic, *kinks, *powers)])
    for at in ((0.3, 1.7), (-0.4, 0.2), (0.5, 0.5), (0.9, 0.1)):
        with precision(BITS):
            values = [float(b) for b in fold(function, digits._RULES, *([flint.arb(v)] for v in at))[0]]
        roundoff(np.array(values), function(*at).full()[:, 0], 10.0)


# Each operation of a tape of relations, against the values that CasADi gives.

X, Z, P = ca.SX.sym("x"), ca.SX.sym("z"), ca.SX.sym("p")
SUM = P * P + 3.0
EXPRESSIONS = {
    "sum": X + Z,
    "difference": X - P * Z,
    "twice": 2.0 * (X + P * Z),
    "negative": -(P * X),
    "times a number": 0.7 * X,
    "over a number": (X + P * Z) / 7.0,
    "over a sum": X / SUM,
    "reciprocal": (1.0 / SUM) * X,
    "number over a sum": (5.0 / SUM) * X - Z / (SUM / 2.0),
    "square": P**2 * X,
    "nested": P * (X + P * (Z - P * X)),
    "coefficient over a coefficient": ((P - 4.0) / (P + 2.0)) * X,
}


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_operation(name: str) -> None:
    parameter = Parameter("p", 1.0, 0.5, 2.0)
    residual = EXPRESSIONS[name]
    function = ca.Function("relation", [X, Z, P], [residual])
    lft = extracted(LinearModel(residual, ca.SX(0, 1), X, Z, P, (parameter,)))
    points = np.linspace(0.5, 2.0, 7)
    found = evaluate_text(lft, {"p": to_delta(parameter, points)})
    expected = [[[float(function(*unit, p)) for unit in ((1, 0), (0, 1))]] for p in points]
    roundoff(found, expected, kappa=10.0)
