"""Texts of expressions: their values are what Python makes of them, or they are errors.

A text is drawn (long, deep, with literals of any size, units, functions of constants, terms that
cancel), or drawn and mutated, or hostile. Python reads it in fractions, or in 60 digits where there are
functions; the package reads it as a tree, and as the entry of a matrix.
"""

import re
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import mpmath
import numpy as np

import mbdlft
from mbdlft import MbdlftError, Parameter
from mbdlft.base.expression import check_degree, evaluate, parse, write
from mbdlft.base.unit import parse_unit
from tests.attack.mutations import changed, check_message
from tests.close import ATTACKED

PARAMETERS = (
    Parameter("a", 0.2, low=-0.5, high=0.6),
    Parameter("b", 1.5, low=1.25, high=2.0),
    Parameter("m_1", 2e5, low=1e5, high=4e5),
    Parameter("ψ", -3e-7, low=-4e-7, high=-1e-7),
)
NAMES = tuple(p.name for p in PARAMETERS)
ANGLES = ("sqrt(2)", "sin(0.3)", "cos(40*deg)", "atan(1/2)", "pi", "sqrt(2)*sqrt(3)-sqrt(6)", "deg")
NUMBERS = (
    "0", "1", "2", "3.5", "0.1", ".25", "7.", "1e3", "2.5E-3", "1e-9", "123456789012345678", "00012",
    "0.1000000000000000055511151231257827", "1e155", "1e-155", "3e+2",
)  # fmt: skip
UNITS = {
    "m": Fraction(1), "kg m^2": Fraction(1), "mm": Fraction(1, 1000), "km": Fraction(1000),
    "g": Fraction(1, 1000), "kN/mm": Fraction(10**6), "%": Fraction(1, 100), "h": Fraction(3600),
    "cm^3": Fraction(1, 10**6), "mm^4": Fraction(1, 10**12), "g/cm^3": Fraction(1000),
    "ug": Fraction(1, 10**9), "nm^3": Fraction(1, 10**27), "1/%": Fraction(100), "dm min": Fraction(6),
}  # fmt: skip
BLANKS = ("", "", "", " ", "  ", "\t", "\n", "\u00a0", "\u2003")
TOKEN = re.compile(
    r"(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?P<unit>\s*\[[^\]]*\])?|(?P<name>[^\W\d]\w*)"
)
KNOWN = {"pi", "deg", "sqrt", "sin", "cos", "atan"}


def attack(seed: int, folder: Path) -> str:
    """Draw a text, and read it in one of four ways."""
    random = np.random.default_rng(seed)
    way = random.random()
    if way < 0.12:
        return hostile(random)
    is_matrix = way < 0.3
    text = drawn(random, int(random.integers(1, 7)), units=not is_matrix)
    if 0.12 < way < 0.15 or way > 0.7:
        text = changed(text, random)
    return in_a_matrix(text, random) if is_matrix else as_a_tree(text, random)


# the two readers -----------------------------------------------------------------------------


def by_python(text: str, at: Mapping[str, Any], number: Callable[[Any], Any]) -> Any:
    """What Python makes of a text; a KeyError if it has a unit or a name that is not known here."""

    def made(match: re.Match[str]) -> str:
        if match["name"]:
            return match["name"] if match["name"] in KNOWN else f"V[{match['name']!r}]"
        named = (match["unit"] or "").strip()[1:-1].replace("**", "^")
        unit = f"*U[{named!r}]" if named else ""
        return f"(N({match['number']!r}){unit})"

    python = TOKEN.sub(made, re.sub(r"\s", " ", text.replace("^", "**")))
    units = {unit: number(x) for unit, x in UNITS.items()}
    known = {name: getattr(mpmath, name) for name in ("sqrt", "sin", "cos", "atan", "pi")}
    names = {"__builtins__": {}, "N": number, "U": units, "V": at, **known}
    return eval(f"({python})", names | {"deg": mpmath.pi / 180})


def digits(text: str | float | Fraction) -> Any:
    """A number in as many digits as mpmath has."""
    fraction = Fraction(text if isinstance(text, str | Fraction) else repr(text))
    return mpmath.mpf(fraction.numerator) / fraction.denominator


def as_a_tree(text: str, random: np.random.Generator) -> str:
    """Values of the tree, and of the text that is written of it, in fractions or in 60 digits."""
    at: dict[str, Any] = {p.name: _inside(p, random) for p in PARAMETERS}
    try:
        tree = parse(text)
        check_degree(tree, dict.fromkeys(NAMES, 1))
        evaluate(tree, {name: float(x) for name, x in at.items()} | {"pi": 3.1, "deg": 0.01})
    except MbdlftError as error:
        check_message(error)
        return f"refused: {type(error).__name__}"
    is_rational = not KNOWN & set(re.findall(r"[^\W\d]\w*", text))
    with mpmath.workdps(60):
        number = Fraction if is_rational else digits
        values = {name: number(x) for name, x in at.items()}
        try:
            expected = by_python(text, values, number)
        except ZeroDivisionError:
            return "division by zero"
        except KeyError:
            return "unknown unit"
        values |= {"pi": mpmath.pi(), "deg": mpmath.pi / 180}
        functions = {name: getattr(mpmath, name) for name in ("sqrt", "sin", "cos", "atan")}
        for each in (tree, parse(write(tree))):
            found = evaluate(each, values, lambda x: number(repr(x)), functions)
            if is_rational:
                assert found == expected, f"{text!r} is {found} in place of {expected}"
            elif mpmath.isfinite(expected):
                size = max(abs(expected), mpmath.mpf("1e-20"))
                assert abs(found - expected) <= mpmath.mpf("1e-20") * size, repr(text)
    return "exact" if is_rational else "in 60 digits"


def in_a_matrix(text: str, random: np.random.Generator) -> str:
    """Values of the model of one entry."""
    try:
        model = mbdlft.realize([[text]], PARAMETERS, search=0.0)
    except MbdlftError as error:
        check_message(error)
        return f"matrix refused: {type(error).__name__}"
    points = [{p.name: _inside(p, random) for p in PARAMETERS} for _ in range(10)]
    with mpmath.workdps(1500):  # whatever cancels
        expected = np.array(
            [float(by_python(text, {n: digits(x) for n, x in at.items()}, digits)) for at in points]
        )
    at = {name: np.array([float(point[name]) for point in points]) for name in NAMES}
    found = mbdlft.matrices_at(model, at).D[:, 0, 0]
    size = max(np.max(np.abs(expected)), 1e-30)
    error = float(np.max(np.abs(found - expected))) / size
    allowed = max(ATTACKED, 10.0 * model.certificate.max_relative_error)
    assert error <= allowed, f"{text!r} differs by {error:.1e}, the certificate says {allowed:.1e}"
    return "matrix exact"


def _inside(p: Parameter, random: np.random.Generator) -> Fraction:
    """A double in the range of a parameter."""
    return Fraction(float(np.clip(random.uniform(p.low, p.high), p.low, p.high)))


# texts ---------------------------------------------------------------------------------------


def drawn(random: np.random.Generator, depth: int, *, units: bool) -> str:
    """A text of the grammar."""

    def one(*items: str) -> str:
        return items[int(random.integers(len(items)))]

    def atom(depth: int) -> str:
        kind = random.random()
        if depth <= 0 or kind < 0.3:
            if random.random() < 0.5:
                return one(*NAMES)
            unit = f"{one(*BLANKS)}[{one(*UNITS)}]" if units and random.random() < 0.2 else ""
            return one(*NUMBERS) + unit
        if kind < 0.4:
            return f"({one(*ANGLES)})"
        inner = total(depth - 1)
        if kind < 0.5:
            return f"({inner})^{one('2', '3', '-1', '(-2)', '0', '1', '7')}"
        if kind < 0.6:
            term = inner if random.random() < 0.5 else f"1e{int(random.integers(0, 20))}*({inner})"
            return f"({total(depth - 1)} + {term} - ({term}))"
        return "(" * (extra := int(random.choice([1, 1, 1, 30]))) + inner + ")" * extra

    def total(depth: int) -> str:
        length = int(random.choice([1, 2, 2, 3, 3, 5, 40 if depth < 2 else 2]))
        text = one("", "", "-", "--+", "+") + atom(depth)
        for _ in range(length - 1):
            operator = one("+", "-", "*", "*", "/", "**2 +", " - -")
            text += one(*BLANKS) + operator + one(*BLANKS) + atom(depth - 1)
        return text

    return total(depth)


def hostile(random: np.random.Generator) -> str:
    """Texts that are very long, deep or strange, as expressions, names, units and entries."""
    n = int(10 ** random.uniform(2, 5))
    texts = (
        "(" * n + "1" + ")" * n, "-" * n + "1", "1" + "+1" * n, "*".join(["a"] * n), "a" * n, "9" * n,
        "0." + "0" * n + "1", f"1e{n}", f"1e-{n}", f"a^{n}", "a" + "^2" * n, "[" * n, f"2 [{'m ' * n}]",
        "sqrt(" * n + "2" + ")" * n, "/".join(["a"] * n), "(a+" * 90 + "1" + ")" * 90, f"2 [m^{n}]",
        "٣*a", "a²", "a^²", "２*a", "a\u200b*b", "a\x00", "\ufeffa", "a\u202eb", "é" * n, "😀", "a·b",
        "__import__('os')", "V['a']", "a.real", "lambda: 0", "a if b else 1", "'" * n, "\n" * n, "\ud800",
        "sin(" + "1+" * n + "1)", "(1/0)*a", "0^-1", "a/(b-b)", "((((9^64)^64)^64)^64)", "(a^64)^64",
        "sqrt(-1)", "cos(1e308*10)", "1e308*1e308*a", "a*nan", "inf", "0x10", "1_000", "1e5e5", "..1",
        "+".join(f"1e{k}*a-1e{k}*a" for k in range(n % 300)),
        "a" + "-a" * (n // 10), "deg^64",
    )  # fmt: skip
    text = texts[int(random.integers(len(texts)))]
    uses: tuple[Callable[[], Any], ...] = (
        lambda: evaluate(parse(text), {"a": 0.5, "b": 2.0}),
        lambda: mbdlft.realize([[text]], PARAMETERS, search=0.0),
        lambda: mbdlft.realize([["a", text], ["b", 1]], PARAMETERS, search=0.0, states=1),
        lambda: parse_unit(text),
        lambda: Parameter(text, 1.0, percent=10),
        lambda: Parameter("p", 1.0, percent=10, unit=text),
        lambda: mbdlft.scene_from_toml(text),
        lambda: mbdlft.PointMass(name="p", mass=text),
    )
    use = int(random.integers(len(uses)))
    try:
        uses[use]()
    except MbdlftError as error:
        check_message(error)
        return "hostile refused"
    return "hostile read"
