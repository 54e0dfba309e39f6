"""Equations with kinks, jumps, modes, implicit functions, scales from 1e-12 to 1e12: slopes by mpmath.

The equations are texts of Modelica, the reference evaluates the same texts with 100 digits, and shares no
code with the package. A kink at the equilibrium, or inside of the range, has to be named. So has a mode,
a Boolean or an Integer, that changes inside of the range.
"""

import itertools
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest

import mbdlft
from mbdlft import MbdlftError
from mbdlft.base.array import Array
from mbdlft.dae import reduce_index, trim
from mbdlft.modelica import flat_model, translate
from tests.close import CLOSED_FORM, target

K = (0.8, 1.0, 1.0625, 1.2)  # values of the parameter
_STEP = mpmath.mpf(10) ** -35  # of differences, of 100 digits
_NAMES: dict[str, Any] = {
    **{name: getattr(mpmath, name) for name in ("sin", "cos", "exp", "log", "sqrt", "atan", "atan2")},
    **{"sign": mpmath.sign, "mpf": mpmath.mpf, "abs": abs, "max": max, "min": min},
}
# f of der(x) = u - s f(v, k) at v = 1, where v is x/s
_RIGHT = (
    "k*v", "v^2/k", "sin(v)*k", "k*v/(4 + v^2)", "sqrt(v)*k", "exp(v) - k", "log(v) + k*v", "k*abs(v)",
    "max(k*v, -v)", "min(k*v, 3*v + 9)", "v*abs(v)", "(if v > 0 then k*v else v^2)", "abs(k + 3)*v",
    "(if v < -1 then 0 else k*v)", "max(k, 0.5)*v", "(if k > 0.5 then v else 0)", "sqrt((1/k)^2)*v",
    "sqrt(k*(k*0.09))*v", "k*v*sign(v - 3)", "(v - 1)*abs(v - 1) + k*v",
    "(if v > 1 then k*v else k*v + v^2 - 2*v + 1)", "k*v + sign(v - 1)*abs(v - 1)",
)  # fmt: skip
_REFUSED = {  # by words of the message
    "two slopes": ("k*abs(v - 1)", "max(v, k*(v - 1) + 1)", "(if v > 1 then v else 3*v - 2)"),
    "jumps": ("sign(v - 1)", "(if v > 1 then v + k else v)"),
    "changes its branch": ("abs(k - 1)*v", "max(k, 1.1)*v", "(if k > 1 then v else 2*v)"),
    "not rational": ("sqrt(k)*v", "exp(v/k)", "sin(k*v)"),
}
_LEAST = 1e-6  # of an unknown without a nominal value beside others that are far larger
# = v/2
_IMPLICIT = "sin(w)", "w + w^3", "sqrt(w)", "w*abs(w)", "atan(w)", "w*exp(w)", "max(w, 2*w)", "1.7*w"


_PARTS = "(x - 1)", "(z - 2)", "(2*x - z)", "(k*x - k)", "x", "z", "k", "2"
_NESTED = "max({}, {})", "min({}, {})", "abs({})", "sign({})", "({})*({})", "({}) + ({})", "({}) - 1"
_EPSILON = mpmath.mpf(10) ** -30
# of x and z
_DIRECTIONS = [(a, b) for a in (-5, -2, -1, 0, 1, 2, 5) for b in (-7, -3, -1, 0, 1, 3, 7) if a or b]


def text_of(equations: str, starts: dict[str, float], declared: str = "") -> str:
    """A flat model with the state x, the input u, the parameter k, and with z if an equation has it."""
    names = ["x", "z"] if re.search(r"\bz\b", equations) else ["x"]
    fresh = [name for name in names if f"Real {name}" not in declared]
    variables = [f"Real {name}(start={starts.get(name, 0.0)!r});" for name in fresh]
    return "\n".join([
        f"model M\nparameter Real k(min={K[0]}, max={K[-1]})=1;", *variables, declared,
        f"input Real u(start={starts.get('u', 0.0)!r});", f"output Real y={names[-1]};",
        "equation", *(f"{equation};" for equation in equations.split(";")), "end M;",
    ])  # fmt: skip


def slopes(
    equations: str,
    starts: dict[str, float],
    k: float,
    at_x: float | None = None,
    **scaled: tuple[str, float],
) -> Array:
    """A, B, C by mpmath; at the equilibrium near the start values, or at a value of x.

    `scaled` are other names: v=("x", s) is x/s.
    """
    with mpmath.workdps(100):
        numbers, codes = r"(?<![\w.])(\d[\d.]*(e[-+]?\d+)?)", []
        for equation in equations.replace("^", "**").replace("der(x)", "rate").split(";"):
            text = re.sub(r"if (.*?) then (.*?) else ([^()]*)", r"((\2) if \1 else (\3))", equation)
            left, right = re.sub(numbers, r"mpf('\1')", text).strip().split(" = ")
            codes.append(compile(f"({left}) - ({right})", "equation", "eval"))
        others = ["z"] if codes[1:] else []

        def solved(names: list[str], near: list[Any], **known: Any) -> list[Any]:
            def residual(*values: Any) -> list[Any]:
                every = _NAMES | known | dict(zip(names, values, strict=True))
                every["k"] = mpmath.mpf(repr(k))
                for name, (of, size) in scaled.items():
                    every[name] = every.get(of, 0) / mpmath.mpf(repr(size))
                return [eval(code, every) for code in codes]  # texts of the tests

            near = [mpmath.mpf(repr(x) if isinstance(x, float) else x) for x in near]
            return list(mpmath.findroot(residual, near, tol=1e-70, verify=False))

        u, z = mpmath.mpf(repr(starts.get("u", 0.0))), [starts[name] for name in others]
        if at_x is None:
            x, *z = solved(["x", *others], [starts.get("x", 0.0), *z], u=u, rate=mpmath.mpf(0))
        else:
            x = mpmath.mpf(repr(at_x))
        columns = []
        for dx, du in ((_STEP * (abs(x) or 1), 0), (0, _STEP * (abs(u) or 1))):
            ends = [solved(["rate", *others], [0, *z], x=x + h * dx, u=u + h * du) for h in (-1, 1)]
            columns.append([(b - a) / (2 * (dx + du)) for a, b in zip(*ends, strict=True)])
        return np.array([columns[0][0], columns[1][0], columns[0][1] if others else 1], dtype=float)


def check(linear: mbdlft.LFTModel, right: dict[float, Array]) -> None:
    """The model has the slopes A, B, C of the reference, relative to their largest at these values."""
    largest = np.max(np.abs([*right.values()]), axis=0)
    for k, values in right.items():
        matrices = mbdlft.matrices_at(linear, {"k": k})[:3]
        for matrix, value, scale in zip(matrices, values, largest, strict=True):
            target(np.ravel(matrix), np.array([value]), CLOSED_FORM, scale)


def nested(random: np.random.Generator, depth: int = 4) -> str:
    """A function of x, z and k with switches in each other, many of which meet at x = 1, z = 2."""
    if not depth or random.random() < 0.15:
        return str(random.choice(_PARTS))
    form = str(random.choice(_NESTED))
    return form.format(*(nested(random, depth - 1) for _ in range(form.count("{}"))))


def slopes_beside(function: str, k: str) -> tuple[Any, Any] | None:
    """The slopes by x and z at x = 1, z = 2, or None where those of directions contradict them."""
    with mpmath.workdps(100):
        code = compile(re.sub(r"(?<![\w.])(\d+)", r"mpf(\1)", function), "function", "eval")

        def slope(dx: int, dz: int) -> Any:
            at = {"x": 1 + dx * _EPSILON, "z": 2 + dz * _EPSILON, "k": mpmath.mpf(k)}
            return (mpmath.mpf(eval(code, _NAMES | at)) - value) / _EPSILON

        value = mpmath.mpf(0)
        value = slope(0, 0) * _EPSILON
        by_x, by_z = slope(1, 0), slope(0, 1)
        errors = [abs(slope(dx, dz) - dx * by_x - dz * by_z) for dx, dz in _DIRECTIONS]
        return (mpmath.chop(by_x, 1e-20), mpmath.chop(by_z, 1e-20)) if max(errors) < 1e-20 else None


def nested_switches(random: np.random.Generator) -> str:
    """A rate with switches in each other: its slopes, or an error; where it has none an error."""
    function = nested(random)
    right = {k: slopes_beside(function, repr(k)) for k in K}
    declared = "output Real z(start=2); input Real v;"
    text = text_of(f"der(x) = u - ({function}); der(z) = v - z", {"x": 1.0, "z": 2.0}, declared)
    at = trim(reduce_index(translate(flat_model(text))[0]), {"x": 1.0, "z": 2.0}, free=["u", "v"])
    try:
        linear = mbdlft.linearize_dae(at, search=0.0, prove=0.0)
    except MbdlftError as error:
        if "please report" in str(error):
            raise AssertionError(function) from error
        return "nested, refused"
    places = [[s.name for s in linear.states].index(name) for name in "xz"]
    for k, slopes in right.items():
        assert slopes is not None, f"{function} has no slopes at k = {k}"
        found = mbdlft.matrices_at(linear, {"k": k}).A[places[0], places]
        target(-found, np.array(slopes, dtype=float), CLOSED_FORM)
    return "nested, right"


_GRID = [Fraction(k, 400) for k in range(320, 481)]  # the range of k
_SIDES = "x", "k", "2*x", "k*x", "x - k", "x^2"
_RELATIONS = "<", "<=", ">", ">="
_TRUTHS = (
    "{}",
    "{} and {}",
    "{} or {}",
    "not ({})",
    "pre(b) or {}",
    "pre(b) and {}",
    "b == ({})",
    "n > 2 and {}",
)


def modes(random: np.random.Generator) -> str:
    """A Boolean and an Integer of x and k: what they are at nominal holds for all k, or an error."""
    forms = [str(random.choice(_TRUTHS)) for _ in "bn"]
    sides = [
        [
            f"{random.choice(_SIDES)} {random.choice(_RELATIONS)} {random.integers(-8, 33)}/16"
            for _ in range(form.count("{}"))
        ]
        for form in forms
    ]
    slower = Fraction(str(random.choice(["0", "0.125"])))
    b, n = (form.format(*relations) for form, relations in zip(forms, sides, strict=True))
    text = text_of(
        f"b = {b}; n = if {n} then 2 else 3; der(x) = 1 - (k + (if b then 0 else {slower}))*x + u; "
        "y = (if b then 1 else 5)*n*x",
        {"x": 1.0},
        "Boolean b; Integer n;",
    ).replace("y=x", "y")
    pairs = [(is_true, number) for is_true in (True, False) for number in (2, 3)]

    def value(formula: str, k: Fraction, b: bool, n: int, moved: float = 0.0) -> bool:
        x = Fraction(moved) + 1 / (k + (0 if b else slower))
        python = re.sub(r"(-?\d+)/16", r"F(\1, 16)", formula).replace("pre(b)", "b").replace("^", "**")
        return bool(eval(python, {"F": Fraction, "k": k, "x": x, "b": b, "n": n}))  # texts of the tests

    def holds(k: Fraction, b: bool, n: int) -> bool:
        first, second = (
            value(form.format(*each), k, b, n) for form, each in zip(forms, sides, strict=True)
        )
        return first == b and second == (n == 2)

    def is_clear(b: bool, n: int) -> bool:
        """Whether relations that do not change, here or near here, decide."""
        grid = [(k, moved) for k in _GRID for moved in (-1e-3, 0.0, 1e-3)]
        for form, each, right in zip(forms, sides, (b, n == 2), strict=True):
            truths = ({value(r, k, b, n, moved) for k, moved in grid} for r in each)
            if any(value(form.format(*of), _GRID[0], b, n) != right for of in itertools.product(*truths)):
                return False
        return True

    try:
        at = trim(reduce_index(translate(flat_model(text))[0]))
        linear = mbdlft.linearize_dae(at, search=0.0, prove=0.0)
    except MbdlftError as error:
        if re.search("changes its branch|jumps", str(error)):
            there = [pair for pair in pairs if holds(Fraction(1), *pair)]
            assert not there or not all(is_clear(*pair) for pair in there), f"refused: {text}"
            return "modes, refused"
        return "modes, no equilibrium"
    y = float(mbdlft.matrices_at(linear, {}).C[0, 0])
    ((b_found, n_found),) = (pair for pair in pairs if round(y) == (1 if pair[0] else 5) * pair[1])
    for k in _GRID:
        A, _, C, _ = (float(matrix[0, 0]) for matrix in mbdlft.matrices_at(linear, {"k": float(k)}))
        assert holds(k, b_found, n_found), f"other modes at k = {k}: {text}"
        target(A, float(-k - (0 if b_found else slower)), CLOSED_FORM)
        target(C, (1 if b_found else 5) * n_found, CLOSED_FORM)
    return "modes, right"


def attack(seed: int, folder: Path) -> str:
    """One function of the lists in other scales, with an implicit one beside it now and then."""
    random = np.random.default_rng(seed)
    if seed % 3 == 2:
        return nested_switches(random) if seed % 2 else modes(random)
    mantissas, powers = random.uniform(1, 9, 4), random.integers(-12, 13, 4)
    s, scale, t, other = (float(f"{m:.3g}e{e}") for m, e in zip(mantissas, powers, strict=True))
    kinds = [(f, "") for f in _RIGHT]
    kinds += [(f, words) for words, functions in _REFUSED.items() for f in functions]
    f, words = kinds[int(random.integers(len(kinds)))]
    equations, starts = f"{scale}*der(x) = {scale}*(u - {s}*({f}))", {"x": s}
    if random.random() < 0.5:
        implicit, factor = random.choice(_IMPLICIT), random.choice(["", "k*", "k^2*"])
        equations += f"; {factor}({other}*({implicit})) = {factor}({other}*v/2)"
        if t > _LEAST:
            equations = equations.replace(f"({f})", f"({f} + exp(w))", 1)
        starts["z"] = 0.4 * t
    text = text_of(re.sub(r"\bw\b", f"(z/{t})", re.sub(r"\bv\b", f"(x/{s})", equations)), starts)
    at = trim(reduce_index(translate(flat_model(text))[0]), at={"x": s}, free=["u"])
    if words:
        with pytest.raises(MbdlftError, match=words):
            mbdlft.linearize_dae(at)
        return f"refused: {words}"
    try:
        linear = mbdlft.linearize_dae(at, search=0.0)
    except MbdlftError as error:
        raise AssertionError(f"refused: {equations}") from error
    check(linear, {k: slopes(equations, starts, k, s, v=("x", s), w=("z", t)) for k in K})
    return "right"
