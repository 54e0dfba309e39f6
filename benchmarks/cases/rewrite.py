"""Other ways to write the entries of a matrix: the same values, other orders of terms and factors.

Polynomials are expanded, nested (Horner) or split by a variable; sums and products are permuted and put
together in random order. Quotients keep their numerator and denominator, each written anew.
"""

import random
import re
from collections.abc import Callable, Mapping
from fractions import Fraction

import numpy as np

from mbdlft.base.expression import Binary, Expression, Name, Negative, Number, Power, parse

Polynomial = dict[tuple[tuple[str, int], ...], Fraction]  # monomial: coefficient
WAYS = ("expanded", "nested", "split", "permuted")


def rewritten(rows: list[list[str]], seed: int) -> list[list[str]]:
    """Each entry in a way that depends on the seed."""
    generator = random.Random(seed)
    return [[_entry(parse(text), generator) for text in row] for row in rows]


def exact_value(text: str, values: Mapping[str, Fraction]) -> Fraction:
    """Value of a text by Python's own grammar, on fractions."""
    numbers = re.compile(r"(?<![\w.])(\d+\.?\d*(?:[eE][+-]?\d+)?)")
    python = numbers.sub(r"Fraction('\1')", text).replace("^", "**")
    return Fraction(eval(python, {"Fraction": Fraction, **values}))


def _entry(tree: Expression, generator: random.Random) -> str:
    way = generator.choice(WAYS)
    if way == "permuted":
        return _permuted(tree, generator)
    return _parts(tree, way, generator)


def _parts(tree: Expression, way: str, generator: random.Random) -> str:
    """Write polynomial parts in one way; other sums, products and quotients of them as they are."""
    try:
        return _WRITERS[way](_polynomial(tree), generator)
    except ValueError:
        pass
    match tree:
        case Binary(operator, left, right):
            a, b = (_parts(part, way, generator) for part in (left, right))
            return f"({a} {operator} {b})"
        case Negative(operand):
            return f"(-{_parts(operand, way, generator)})"
        case Power(base, exponent):
            return f"({_parts(base, way, generator)})^({exponent})"
    raise AssertionError(tree)


def _polynomial(tree: Expression) -> Polynomial:
    """Coefficients by monomial; a ValueError if the tree divides by more than a number."""
    match tree:
        case Number(value):
            return _sum({}, {(): Fraction(repr(value))})
        case Name(name):
            return {((name, 1),): Fraction(1)}
        case Negative(operand):
            return _product({(): Fraction(-1)}, _polynomial(operand))
        case Power(base, exponent) if exponent >= 0:
            result: Polynomial = {(): Fraction(1)}
            for _ in range(exponent):
                result = _product(result, _polynomial(base))
            return result
        case Binary(operator, left, right):
            a, b = _polynomial(left), _polynomial(right)
            if operator == "/":
                if set(b) != {()}:
                    raise ValueError
                return _product(a, {(): 1 / b[()]})
            if operator == "*":
                return _product(a, b)
            return _sum(a, b if operator == "+" else _product({(): Fraction(-1)}, b))
    raise ValueError


def _sum(a: Polynomial, b: Polynomial) -> Polynomial:
    total = dict(a)
    for monomial, coefficient in b.items():
        total[monomial] = total.get(monomial, Fraction(0)) + coefficient
    return {monomial: coefficient for monomial, coefficient in total.items() if coefficient}


def _product(a: Polynomial, b: Polynomial) -> Polynomial:
    total: Polynomial = {}
    for first, x in a.items():
        for second, y in b.items():
            powers = dict(first)
            for name, power in second:
                powers[name] = powers.get(name, 0) + power
            total = _sum(total, {tuple(sorted(powers.items())): x * y})
    return total


def _expanded(polynomial: Polynomial, generator: random.Random) -> str:
    """A sum of monomials, factors in random order."""
    terms = []
    for monomial, coefficient in polynomial.items():
        factors = [name for name, power in monomial for _ in range(power)]
        factors += [f"({coefficient})"] if coefficient != 1 or not factors else []
        terms.append(_joined("*", factors, generator))
    return _joined("+", terms, generator)


def _nested(polynomial: Polynomial, generator: random.Random) -> str:
    """Horner's way in one variable after the other."""
    names = sorted({name for monomial in polynomial for name, _ in monomial})
    if not names:
        return f"({polynomial.get((), Fraction(0))})"
    name = generator.choice(names)
    inside, rest = _divided(polynomial, name)
    text = _joined("*", [name, _nested(inside, generator)], generator)
    return _joined("+", [text, _nested(rest, generator)], generator) if rest else text


def _split(polynomial: Polynomial, generator: random.Random) -> str:
    """One variable taken out, the remainder expanded."""
    names = sorted({name for monomial in polynomial for name, _ in monomial})
    if not names:
        return _expanded(polynomial, generator)
    name = generator.choice(names)
    inside, rest = _divided(polynomial, name)
    text = _joined("*", [_expanded(inside, generator), name], generator)
    return _joined("+", [text, _expanded(rest, generator)], generator) if rest else text


def _divided(polynomial: Polynomial, name: str) -> tuple[Polynomial, Polynomial]:
    """Quotient and remainder by a variable."""
    inside: Polynomial = {}
    rest: Polynomial = {}
    for monomial, coefficient in polynomial.items():
        powers = dict(monomial)
        if name not in powers:
            rest[monomial] = coefficient
            continue
        powers[name] -= 1
        inside[tuple(sorted((n, k) for n, k in powers.items() if k))] = coefficient
    return inside, rest


def _permuted(tree: Expression, generator: random.Random) -> str:
    """The tree with terms and factors in another order and association."""
    match tree:
        case Binary(operator, _, _) if operator in "+*":
            return _joined(operator, _chain(tree, operator, generator), generator)
        case Binary("-", left, right):
            parts = [_permuted(left, generator), f"(-{_permuted(right, generator)})"]
            return _joined("+", parts, generator)
        case Binary(operator, left, right):
            return f"({_permuted(left, generator)} {operator} {_permuted(right, generator)})"
        case Negative(operand):
            return f"(-{_permuted(operand, generator)})"
        case Power(base, exponent):
            return f"({_permuted(base, generator)})^({exponent})"
        case Number(value):
            return repr(value)
        case Name(name):
            return name
    raise AssertionError(tree)


def _chain(tree: Expression, operator: str, generator: random.Random) -> list[str]:
    if isinstance(tree, Binary) and tree.operator == operator:
        return _chain(tree.left, operator, generator) + _chain(tree.right, operator, generator)
    return [_permuted(tree, generator)]


def _joined(operator: str, parts: list[str], generator: random.Random) -> str:
    """Parts in random order, put together two neighbors at a time."""
    pool = list(parts) or ["0"]
    generator.shuffle(pool)
    while len(pool) > 1:
        k = generator.randrange(len(pool) - 1)
        pool[k : k + 2] = [f"({pool[k]} {operator} {pool[k + 1]})"]
    return pool[0]


_WRITERS: dict[str, Callable[[Polynomial, random.Random], str]] = {
    "expanded": _expanded,
    "nested": _nested,
    "split": _split,
}


def exact_values(rows: list[list[str]], samples: list[dict[str, float]]) -> np.ndarray:
    """Values (N, rows, columns) by arithmetic on fractions, rounded once."""
    found = []
    for sample in samples:
        at = {name: Fraction(value) for name, value in sample.items()}
        found.append([[float(exact_value(text, at)) for text in row] for row in rows])
    return np.array(found)
