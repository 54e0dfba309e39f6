"""Orders of matrices of the literature, as a table.

Run it from the top of the repository: python -m benchmarks.orders [--write docs/orders.md]

The values of a model are verified against arithmetic on fractions before its time is printed.
"""

import argparse
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import mbdlft
from benchmarks.arm import BEGIN, END
from tests.close import SCENARIO
from tests.reference.orders import CASES, Case
from tests.reference.test_orders import exact_values, points

_SEARCH = 20.0  # s; it ends at the bound, or when nothing new is found
_CHECKED = 200


class Row(NamedTuple):
    """One matrix: orders, the proved bound, and seconds."""

    name: str
    shape: str
    parameters: int
    published: str
    plain: int
    searched: int
    bound: int
    error: float
    seconds: float


def measure(case: Case, search: float = _SEARCH) -> Row:
    """Orders with and without search, once the values are verified."""
    problem = case.problem()
    start = time.perf_counter()
    model = mbdlft.realize(problem, search=search, exact=True)
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
        mbdlft.realize(problem).order,
        model.order,
        sum(model.certificate.lower_bound),
        error,
        seconds,
    )


def table(rows: Sequence[Row]) -> str:
    """The rows in Markdown."""
    lines = [
        "| matrix | size | parameters | published | reduced | with search | bound | error | seconds |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.name} | {r.shape} | {r.parameters} | {r.published} | {r.plain} | {r.searched} | "
        f"{r.bound} | {r.error:.1e} | {r.seconds:.2f} |"
        for r in rows
    ]
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    versions = f"Python {platform.python_version()}, numpy {np.__version__}"
    return "\n".join(
        [*lines, "", f"Measured on {machine}, {versions}, a shared and noisy machine."]
    )


def main() -> None:
    """Print the table, and write it into a file between its two marks if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    mbdlft.realize(CASES[0].problem(), search=_SEARCH, exact=True)  # the first one warms up
    text = table([measure(case) for case in CASES])
    print(text)
    if options.write:
        page = options.write.read_text(encoding="utf-8")
        before, _, rest = page.partition(BEGIN)
        _, _, after = rest.partition(END)
        options.write.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
