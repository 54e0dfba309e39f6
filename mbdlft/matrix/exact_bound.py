"""Lower bounds in exact arithmetic: McMillan degrees of a rational matrix modulo a prime.

Fix all parameters but one at random residues. From the values of the matrix at points l_i and m_j of
that parameter, the Loewner matrix

    L_ij = (M(l_i) - M(m_j)) / (l_i - m_j)

has the McMillan degree as its rank, and in no LFT are there fewer repetitions: with p as the delta,
L_ij = M21 (I - l_i M11)^-1 (I - m_j M11)^-1 M12, where M11 has the size of the repetitions.

Numbers are taken as the decimals they print as. A minor of L that is not zero modulo the prime at one
point is not zero as a rational function, so every counted degree is proved, whichever residues were
drawn; a degree may be missed only if a minor happens to vanish, with a probability of about
degree / 2^61.

Mayo, Antoulas, A framework for the solution of the generalized realization problem (2007).
"""

import random
from collections.abc import Mapping
from typing import Any

from mbdlft.base.errors import AnalysisError, NotRationalError, WellPosednessError
from mbdlft.base.parameter import Parameter, cosine_sine_parts
from mbdlft.matrix import MatrixProblem
from mbdlft.matrix.resolve import Resolved, cosine_name, matrix_values, resolve, sine_name
from mbdlft.number.residue import PRIME, Residue

_TRIES = 5
_MOST_POINTS = 512

Rows = list[list[int]]


def exact_lower_bound(problem: MatrixProblem, seed: int = 0) -> dict[str, int]:
    """Proved minimum of the repetitions of each parameter in any exact LFT of a matrix.

    Parameters
    ----------
    problem : MatrixProblem
        All its numbers are rational: no ``pi``, ``sqrt``, or sine and cosine of constants.
    seed : int
        Of the residues that are drawn.

    Returns
    -------
    mapping of names to McMillan degrees, in exact arithmetic

    Raises
    ------
    NotRationalError
        A number is not rational.
    WellPosednessError
        A denominator is zero whatever the values of the parameters.
    AnalysisError
        python-flint is not installed.
    """
    resolved = resolve(problem)
    if resolved.irrational:
        raise NotRationalError(
            f"{resolved.irrational[0]} is not a rational number, so there is no exact arithmetic with "
            "it. Write its decimals, declare it as a parameter, or leave exact out."
        )
    flint = _flint()
    generator = random.Random(seed)
    return {
        p.name: _degree(flint, problem, resolved, p.name, generator) for p in problem.parameters
    }


def _flint() -> Any:
    try:
        import flint
    except ImportError:
        raise AnalysisError(
            "exact bounds need python-flint, which is not installed: pip install 'mbdlft[exact]'."
        ) from None
    return flint


def _degree(
    flint: Any, problem: MatrixProblem, resolved: Resolved, name: str, generator: random.Random
) -> int:
    """McMillan degree in one parameter: points are doubled until the rank does not grow."""
    if name not in _used(resolved):
        return 0
    others = {p.name: generator.randrange(PRIME) for p in problem.parameters}
    left: list[tuple[int, Rows]] = []
    right: list[tuple[int, Rows]] = []
    rank, count = -1, 1
    while count <= _MOST_POINTS:
        for side in (left, right):
            while len(side) < count:
                side.append(_sample(problem, resolved, others, name, generator))
        found = int(_loewner(flint, left, right).rank())
        if found == rank:
            break
        rank, count = found, 2 * count
    return rank


def _used(resolved: Resolved) -> frozenset[str]:
    return frozenset(
        name for row in resolved.entries for entry in row for name in resolved.parameters_of(entry)
    )


def _sample(
    problem: MatrixProblem,
    resolved: Resolved,
    others: Mapping[str, int],
    name: str,
    generator: random.Random,
) -> tuple[int, Rows]:
    """A random value of one parameter and the matrix there; where it has a pole, another one."""
    for _ in range(_TRIES):
        point = generator.randrange(PRIME)
        internal = {**others, name: point}
        values: dict[str, Any] = {
            key: Residue.of(float(value))
            for key, value in problem.constant_values().items()
            if key not in ("pi", "deg")
        }
        for p in problem.parameters:
            values |= _residues(p, Residue(internal[p.name]))
        try:
            rows = matrix_values(problem, resolved, values, Residue.of)
        except ValueError:  # no inverse modulo the prime
            continue
        return point, [[Residue.of(entry).value for entry in row] for row in rows]
    raise WellPosednessError(
        f"matrix {problem.name!r}: a denominator is zero whatever the values of the parameters."
    )


def _residues(parameter: Parameter, t: Residue) -> dict[str, Residue]:
    """A parameter by its internal value; the degree does not depend on the reference of an angle."""
    if not parameter.is_angle:
        return {parameter.name: t}
    c, s, denominator = cosine_sine_parts(parameter.substitution, t)
    return {
        cosine_name(parameter.name): c / denominator,
        sine_name(parameter.name): s / denominator,
    }


def _loewner(flint: Any, left: list[tuple[int, Rows]], right: list[tuple[int, Rows]]) -> Any:
    """The Loewner matrix of values at two sets of points, modulo the prime."""
    height, width = len(left[0][1]), len(left[0][1][0])
    entries = []
    for point, at_left in left:
        inverses = [pow(point - m, -1, PRIME) for m, _ in right]
        for i in range(height):
            for (_, at_right), inverse in zip(right, inverses, strict=True):
                entries += [
                    (at_left[i][j] - at_right[i][j]) * inverse % PRIME for j in range(width)
                ]
    return flint.nmod_mat(len(left) * height, len(right) * width, entries, PRIME)
