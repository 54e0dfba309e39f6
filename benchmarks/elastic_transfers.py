"""Transfer functions of elastic models against 50 digits: of tips of chains, accelerations and positions.

    python -m benchmarks.elastic_transfers [--only 0,3] [--write docs/flexible.md]

The truth are the equations, trimmed, linearized and solved in 50 digits. The matrices of the model are
doubles; beside its error stands that of the exact matrices, rounded to doubles: no model in doubles can
be relied on to do better. Both are evaluated in 50 digits, so that nothing else is in them.
"""

import argparse
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import flint
import numpy as np

import mbdlft
from benchmarks.arm import machine, write_between
from benchmarks.cases.hub import hub
from mbdlft.exact.numbers import precision
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.problem.digits import transfers_of

OMEGA = np.geomspace(0.1, 1e4, 6)  # rad/s
PROMISED, TIMES_ROUNDED = 1e-7, 2.0
_BITS = 200


class Case(NamedTuple):
    """A chain: beams, elements of each, what is uncertain, and whether it moves in space."""

    beams: int
    elements: int
    uncertain: str
    is_spatial: bool = False


class Row(NamedTuple):
    """Errors relative to the largest of the row at its frequency."""

    case: Case
    order: int
    states: int
    error: float
    rounded: float
    seconds: float

    @property
    def is_met(self) -> bool:
        """Whether the error is what was promised, or no more than twice that of rounding."""
        return self.error <= max(PROMISED, TIMES_ROUNDED * self.rounded)


CASES = (
    Case(1, 4, ""),
    Case(1, 30, ""),
    Case(2, 8, ""),
    Case(3, 8, ""),
    Case(4, 12, ""),
    Case(2, 6, "", is_spatial=True),
    Case(1, 4, "L"),
    Case(1, 10, "L"),
    Case(1, 20, "L"),
    Case(1, 30, "L"),
    Case(1, 12, "E rho"),
    Case(1, 6, "A I E rho L"),
    Case(2, 8, "L"),
    Case(3, 4, "L"),
    Case(3, 4, "L E rho"),
    Case(3, 8, "L"),
    Case(4, 4, "L"),
    Case(2, 4, "L E rho", is_spatial=True),
)


def measured(case: Case) -> Row:
    """Build a model, and compare it at nominal and where all parameters are lowest or highest."""
    scene = hub(case.beams, case.elements, case.uncertain.split(), is_spatial=case.is_spatial)
    start = time.process_time()
    model = mbdlft.to_lft(scene, search=0.0)
    seconds = time.process_time() - start
    problem = problem_of_scene(scene)
    points, reference = problem.points, problem.reference()
    middle = np.array([p.nominal for p in problem.parameters])
    sides = np.sign(points - middle).sum(axis=1)
    some = sorted({0, int(np.argmin(sides)), int(np.argmax(sides))})
    truth = reference.transfers_in_digits(some, OMEGA)
    assert reference.in_digits is not None
    exact = reference.in_digits(points[some])
    names = [p.name for p in problem.parameters]
    at = {name: points[some, k] for k, name in enumerate(names)}
    A, B, C, D = (np.asarray(part) for part in mbdlft.matrices_at(model, at))
    own = np.concatenate([np.concatenate([A, B], axis=-1), np.concatenate([C, D], axis=-1)], axis=-2)
    states = A.shape[-1]
    error, rounded = (
        largest(in_digits(values.reshape(exact.shape), states), truth) for values in (own, exact)
    )
    return Row(case, model.order, states, error, rounded, seconds)


def in_digits(values: np.ndarray, states: int) -> np.ndarray:
    """Transfer functions of [A B ; C D] (N, ., .) in doubles, computed in 50 digits."""
    with precision(_BITS):
        balls = [np.frompyfunc(flint.arb, 1, 1)(matrix) for matrix in values]
        return transfers_of(balls, states, OMEGA)


def largest(found: np.ndarray, truth: np.ndarray) -> float:
    """Largest difference of transfer functions (N, F, rows, columns) over the largest of its row."""
    size = np.max(np.abs(truth), axis=-1, keepdims=True)
    return float(np.max(np.abs(found - truth) / np.where(size > 0.0, size, 1.0)))


def table(rows: list[Row]) -> Iterator[str]:
    """Lines of a table."""
    yield "| beams x elements | in | parameters | states | order | error | exact, rounded | s |"
    yield "|---|---|---|---|---|---|---|---|"
    for case, order, states, error, rounded, seconds in rows:
        where = "space" if case.is_spatial else "a plane"
        which = case.uncertain.replace(" ", ", ") or "none"
        yield (
            f"| {case.beams} x {case.elements} | {where} | {which} | {states} | {order} "
            f"| {error:.0e} | {rounded:.0e} | {seconds:.1f} |"
        )


def main() -> None:
    """Measure, check what is promised, print, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="numbers of cases, with commas")
    parser.add_argument("--write", type=Path, help="page that takes the table")
    options = parser.parse_args()
    chosen = [int(k) for k in options.only.split(",") if k] or range(len(CASES))
    rows = []
    for k in chosen:
        rows.append(measured(CASES[k]))
        print([*table(rows[-1:])][-1], "" if rows[-1].is_met else "NOT MET", flush=True)
    missed = [row.case for row in rows if not row.is_met]
    if missed:
        raise SystemExit(f"more than {PROMISED:.0e} and twice the rounding: {missed}")
    if options.write:
        text = "\n".join([*table(rows), "", *textwrap.wrap(machine(), 130)])
        write_between(options.write, text, "transfers")


if __name__ == "__main__":
    main()
