"""Free modes: states that may grow together while nothing chosen sees it, as both angles of a drive do.

Such are x = V c with C V = 0 and A V = V L, the unobservable subspace, the kernel of [C; C A; ...]. With
V_J = 1 in as many states J, the other states are measured from them,

    x'_s = x_s - V_s x_J,      A' = A_ss - V_s A_Js,      B' = B_s - V_s B_J,      C' = C_s,

and the states J are gone. Entries of V_s are numbers, or numbers times powers of parameters: the ratio of
a gear, the speed of a vehicle whose heading is free. They are found modulo a prime, at random parameters.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import isqrt
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.parameter import Parameter, to_internal
from mbdlft.exact.modular import Residues, multiplied, null_space, row_echelon

_LARGEST = 4  # power of a parameter in an entry
_SIZE = 2**44  # numerator times denominator of a number that is found: few residues are such by chance


class Monomial(NamedTuple):
    """A number times powers of internal values."""

    number: Fraction
    powers: tuple[int, ...]  # (n_p,)

    def symbol(self, p: ca.SX) -> ca.SX:
        """Its value at the symbols (n_p,)."""
        value = ca.SX(self.number.numerator) / self.number.denominator
        for k, power in enumerate(self.powers):
            value = value * p[k] ** power if power > 0 else value / p[k] ** -power if power else value
        return value

    def name(self, parameters: Sequence[Parameter], state: str) -> str:
        """What is subtracted of a state of this name, such as ``- 5 motor.angle``."""
        factors = [
            p.name if power == 1 else f"{p.name}^{power}"
            for p, power in zip(parameters, self.powers, strict=True)
            if power
        ]
        factors = [f"{float(abs(self.number)):.6g}"] * (abs(self.number) != 1) + factors
        return f" {'-' if self.number > 0 else '+'} {' '.join([*factors, state])}"


@dataclass(frozen=True, slots=True)
class FreeModes:
    """V_s by its entries that are not zero, at positions of states."""

    dropped: tuple[int, ...]  # J
    entries: Mapping[tuple[int, int], Monomial]  # by a state that stays and one of J
    parameters: tuple[Parameter, ...]

    def turned(self, matrices: Array, points: Array, *, sizes: bool = False) -> Array:
        """[A B ; C D] (N, ., .) at physical values (N, n_p), with x' in place of x; or sizes of them."""
        internal = np.array([to_internal(p, points[:, k]) for k, p in enumerate(self.parameters)])
        turned = np.array(matrices)
        for (s, j), (number, powers) in self.entries.items():
            value = float(number) * np.prod(internal ** np.array(powers)[:, None], axis=0)[:, None]
            value = np.max(np.abs(value)) if sizes else value
            turned[:, s] += (value if sizes else -value) * turned[:, j]
            turned[:, :, j] += value * turned[:, :, s]
        return turned

    def name(self, state: int, names: Sequence[str]) -> str:
        """The name of a state, such as ``load.angle - 5 motor.angle``."""
        others = {j: entry for (s, j), entry in self.entries.items() if s == state}
        return names[state] + "".join(e.name(self.parameters, names[j]) for j, e in others.items())


def unobservable(A: Residues, C: Residues, prime: int) -> Residues:
    """Independent rows V' (J, n) that span it."""
    seen, count = row_echelon(C, prime)[0], -1
    while count != len(seen):
        count = len(seen)
        seen, _ = row_echelon(np.vstack([seen, multiplied(seen, A, prime)]), prime)
    return null_space(seen, prime).T


def free_modes(
    at: Callable[[Sequence[int], int], tuple[Residues, Residues, int]], parameters: tuple[Parameter, ...]
) -> FreeModes | None:
    """The free modes of A and C that a function gives at integers (n_p,) and a seed, with the prime.

    The states that go are the first or the last that can, whatever divides by fewer parameters. None if
    an entry is not a monomial.
    """
    count = len(parameters)
    draw = np.random.default_rng(count).integers(2, 2**40, (2, count)).tolist()
    A, C, prime = at(draw[0], 0)
    spaces = [unobservable(A, C, prime)]
    if not len(spaces[0]):
        return FreeModes((), {}, parameters)
    spaces.append(unobservable(*at(draw[1], 1)))
    doubled = ([x << (i == k) for i, x in enumerate(draw[0])] for k in range(count))
    spaces += [unobservable(*at(point, 0)) for point in doubled]
    first = _by_monomials(spaces, prime, draw, parameters, 1)
    if first is None or not _divisions(first):
        return first
    last = _by_monomials(spaces, prime, draw, parameters, -1)
    return min((modes for modes in (first, last) if modes is not None), key=_divisions)


def _divisions(modes: FreeModes) -> int:
    return sum(power < 0 for entry in modes.entries.values() for power in entry.powers)


def _by_monomials(
    spaces: Sequence[Residues],
    prime: int,
    points: Sequence[Sequence[int]],
    parameters: tuple[Parameter, ...],
    step: int,
) -> FreeModes | None:
    """The modes by the first states that can go (step 1) or the last (-1), if entries are monomials."""
    forms = [row_echelon(space[:, ::step], prime) for space in spaces]
    pivots = forms[0][1]
    if any(others != pivots for _, others in forms):
        return None
    values, order = [V[:, ::step] for V, _ in forms], range(spaces[0].shape[1])[::step]
    dropped = [order[k] for k in pivots]
    entries = {
        (int(s), dropped[j]): _monomial([int(V[j, s]) for V in values], points, prime)
        for j, s in np.argwhere(values[0])
        if s not in dropped
    }
    nonzero = {place: entry for place, entry in entries.items() if entry}
    return FreeModes(tuple(dropped), nonzero, parameters) if len(nonzero) == len(entries) else None


def _monomial(values: Sequence[int], points: Sequence[Sequence[int]], prime: int) -> Monomial | None:
    """The monomial with values at two points, and at the first one with a parameter doubled, for each."""
    first, second, *doubled = values
    powers_of_two = {pow(2, k, prime): k for k in range(-_LARGEST, _LARGEST + 1)}
    ratios = [value * pow(first, -1, prime) % prime for value in doubled]
    if any(ratio not in powers_of_two for ratio in ratios):
        return None
    powers = tuple(powers_of_two[ratio] for ratio in ratios)
    number, expected = first, second
    for base, other, power in zip(*points, powers, strict=True):
        number = number * pow(base, -power, prime) % prime
        expected = expected * pow(other, -power, prime) % prime
    fraction = _fraction(number, prime)
    return Monomial(fraction, powers) if fraction is not None and number == expected else None


def _fraction(residue: int, prime: int) -> Fraction | None:
    """The fraction of small numbers with a residue (Wang 1981), if there is one."""
    a, b, s, t = prime, residue, 0, 1
    while b > isqrt(prime):
        a, b, s, t = b, a % b, t, s - a // b * t
    return Fraction(b, t) if t and abs(b * t) < _SIZE else None
