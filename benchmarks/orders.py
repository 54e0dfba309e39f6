"""Orders of matrices of the literature and of chains of links, as two tables.

Run it from the top of the repository:

    python -m benchmarks.orders [--write docs/orders.md] [--rewritings 100]

The values of a model are verified before its time is printed: of a matrix against arithmetic on
fractions, of a scene against the nonlinear equations, trimmed and linearized again.
"""

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import mbdlft
from benchmarks.arm import machine, write_between
from benchmarks.cases.chains import chain
from benchmarks.cases.orders import CASES, Case, points
from benchmarks.cases.rewrite import exact_values, rewritten
from benchmarks.targets import SCENARIO
from mbdlft.exact.numbers import BITS, precision
from mbdlft.lft.sampling import evaluate_at
from mbdlft.multibody.assembly import assemble
from mbdlft.order.reduction import in_scales, reduce_exactly
from mbdlft.pipeline.extract import extract
from mbdlft.problem.relations import linearize

_SEARCH = 20.0  # s; it ends at the bound, or when nothing new is found
_CHECKED = 200


_CHAINS = ((False, 2), (False, 3), (False, 4), (False, 6), (True, 2), (True, 3), (True, 4), (True, 6))
_CHAIN_SEARCH = 60.0  # s
_LONG_CHAIN, _LONG_SEARCH = 4, 300.0  # links and s: pairs of 18 parameters take a minute


class Row(NamedTuple):
    """One matrix: orders, the proved bound, and seconds; orders of other ways to write it."""

    name: str
    shape: str
    parameters: int
    published: str
    plain: int
    searched: int
    bound: int
    error: float
    seconds: float
    rewritten: str


def measure(case: Case, search: float = _SEARCH, rewritings: int = 0) -> Row:
    """Orders with and without search, once the values are verified."""
    problem = case.problem()
    start = time.perf_counter()
    model = mbdlft.realize(problem, search=search)
    seconds = time.perf_counter() - start
    samples = points(case, _CHECKED)
    values = {name: np.array([sample[name] for sample in samples]) for name in samples[0]}
    m = mbdlft.matrices_at(model, values)
    expected = exact_values(case.matrix, samples)
    size = np.max(np.abs(expected), axis=0)
    difference = np.max(np.abs(np.block([[m.A, m.B], [m.C, m.D]]) - expected), axis=0)
    error = float(np.max(difference / np.where(size > 0, size, 1.0)))
    if not error <= SCENARIO:
        raise SystemExit(f"{case.name} is wrong: relative error {error:.1e}; no times are printed.")
    return Row(
        case.name,
        f"{problem.shape[0]} x {problem.shape[1]}",
        len(case.parameters),
        case.published,
        mbdlft.realize(problem, search=0.0).order,
        model.order,
        model.certificate.order_bound,
        error,
        seconds,
        _rewritten(case, search, rewritings),
    )


def _rewritten(case: Case, search: float, count: int) -> str:
    """Orders of other ways to write a matrix, and how often each was found."""
    search = search if case.order == case.proved else min(search, 1.0)  # no proof ends the search
    found = Counter(
        mbdlft.realize(case.problem(rewritten(case.matrix, seed)), search=search).order
        for seed in range(count)
    )
    return ", ".join(f"{order} ({times})" for order, times in sorted(found.items()))


class ChainRow(NamedTuple):
    """One chain: orders, bounds one by one and by pairs and triples, and seconds."""

    name: str
    parameters: int
    plain: int
    searched: int
    alone: int
    bound: int
    error: float
    seconds: float


def measure_chain(links: int, *, spatial: bool, search: float | None = None) -> ChainRow:
    """Orders with and without search; the certificate has verified the values."""
    scene = chain(links, spatial=spatial)
    if search is None:
        search = _LONG_SEARCH if links >= _LONG_CHAIN else _CHAIN_SEARCH
    start = time.perf_counter()
    certificate = mbdlft.to_lft(scene, search=search).certificate
    seconds = time.perf_counter() - start
    return ChainRow(
        f"{links} links, {'axes x and z in turn' if spatial else 'planar'}",
        len(scene.parameters),
        mbdlft.to_lft(scene, search=0.0).order,
        sum(certificate.order),
        sum(certificate.lower_bound),
        certificate.order_bound,
        certificate.max_relative_error,
        seconds,
    )


def measure_reduction(links: int = 12) -> str:
    """n-D reduction alone of a long chain in space, against values of what it started from."""
    equations = assemble(chain(links, spatial=True))
    with precision(BITS):
        exact, channels = extract(linearize(equations, range(links), range(links)))
        start = time.perf_counter()
        small = in_scales(reduce_exactly(exact).rounded())
        seconds = time.perf_counter() - start
        raw = exact.rounded()
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (4, len(raw.blocks)))
    expected = evaluate_at(raw, points)
    error = float(np.max(np.abs(evaluate_at(small, points) - expected)) / np.max(np.abs(expected)))
    if not error <= SCENARIO:
        raise SystemExit(f"reduction is wrong: relative error {error:.1e}; no times are printed.")
    return (
        f"The relations of {links} links in space, {sum(channels.values())} channels, to {raw.order} by "
        f"words and {small.order} by n-D reduction: {seconds:.1f} s, error of the reduction {error:.1e} "
        "of the largest entry."
    )


def chain_table(rows: Sequence[ChainRow]) -> str:
    """The rows in Markdown."""
    lines = [
        "| chain | parameters | reduced | with search | bound one by one | bound by pairs and triples "
        "| gap | error | seconds |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.name} | {r.parameters} | {r.plain} | {r.searched} | {r.alone} | {r.bound} | "
        f"{100 * (r.searched - r.bound) / r.bound:.0f} % | {r.error:.1e} | {r.seconds:.1f} |"
        for r in rows
    ]
    return "\n".join(lines)


def table(rows: Sequence[Row]) -> str:
    """The rows in Markdown."""
    lines = [
        "| matrix | size | parameters | published | reduced | with search | bound | error | seconds | "
        "rewritten |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.name} | {r.shape} | {r.parameters} | {r.published} | {r.plain} | {r.searched} | "
        f"{r.bound} | {r.error:.1e} | {r.seconds:.2f} | {r.rewritten} |"
        for r in rows
    ]
    return "\n".join([*lines, "", machine()])


def main() -> None:
    """Print the table, and write it into a file between its two marks if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--rewritings", type=int, default=10)
    options = parser.parse_args()
    mbdlft.realize(CASES[0].problem(), search=_SEARCH)  # the first one warms up
    chains = [measure_chain(links, spatial=spatial) for spatial, links in _CHAINS]
    cases = [measure(case, rewritings=options.rewritings) for case in CASES]
    text = "\n\n".join([chain_table(chains), measure_reduction(), table(cases)])
    print(text)
    if options.write:
        write_between(options.write, text)


if __name__ == "__main__":
    main()
