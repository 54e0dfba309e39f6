"""What each part of the search is worth: orders and bounds with one part left out, as a table.

Run it from the top of the repository:

    python -m benchmarks.ablation [--work 2] [--write docs/ablation.md]

Results depend on the work alone, not on the machine or its load.
"""

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import mbdlft
from benchmarks.arm import write_between
from benchmarks.cases.chains import chain
from benchmarks.cases.orders import CASES
from mbdlft.order import exchange
from mbdlft.order.paths import Found
from mbdlft.pipeline import smaller, stages
from mbdlft.system.model import LFTModel

_LINKS = (2, 3, 4)
_LEFT_OUT: dict[str, dict[str, Any]] = {
    "everything": {},
    "without restrictions and exchanges": {"smaller_candidates": lambda *_: iter(())},
    "without exchanges": {"path_below": lambda *_, **__: Found(0, (), 0, ())},
    "without directions that cost nothing": {"unobservable": lambda *_: None},
}

Make = Callable[[float], LFTModel]


class Result(NamedTuple):
    """The order and the proved bound of one case."""

    order: int
    bound: int


def cases() -> Iterator[tuple[str, Make]]:
    """All scenarios, matrices of the literature and chains."""
    for path in sorted(Path("scenarios").glob("*.toml")):
        if "mbdlft-matrix" in path.read_text():
            problem = mbdlft.load_matrix(path)
            yield path.stem, lambda work, problem=problem: mbdlft.realize(problem, search=work)
        else:
            yield path.stem, _of_scene(mbdlft.load_scene(path))
    for case in CASES:
        problem = case.problem()
        yield case.name, lambda work, problem=problem: mbdlft.realize(problem, search=work)
    for spatial in (False, True):
        for links in _LINKS:
            name = f"{links} links, {'spatial' if spatial else 'planar'}"
            yield name, _of_scene(chain(links, spatial=spatial))


def _of_scene(scene: mbdlft.Scene) -> Make:
    return lambda work: mbdlft.to_lft(scene, search=work)


def measure(work: float, left_out: dict[str, Any]) -> dict[str, Result]:
    """Each case with some parts of the search replaced by nothing."""
    with ExitStack() as stack:
        for module, (name, nothing) in product((exchange, smaller, stages), left_out.items()):
            if hasattr(module, name):
                stack.enter_context(patch.object(module, name, nothing))
        models = {name: make(work) for name, make in cases()}
    return {name: Result(model.order, model.certificate.order_bound) for name, model in models.items()}


def table(results: dict[str, dict[str, Result]], work: float) -> str:
    """Sums by what is left out, and the cases in which something changes."""
    lines = [
        f"With {work:g} units of work, {len(next(iter(results.values())))} cases:",
        "",
        "| search | sum of orders | sum of bounds | proved minimal |",
        "|---|---|---|---|",
    ]
    for variant, found in results.items():
        orders, bounds = (sum(side) for side in zip(*found.values(), strict=True))
        minimal = sum(order == bound for order, bound in found.values())
        lines.append(f"| {variant} | {orders} | {bounds} | {minimal} |")
    lines += ["", f"| case, order / bound | {' | '.join(results)} |", "|---" * (len(results) + 1) + "|"]
    for case in next(iter(results.values())):
        row = [found[case] for found in results.values()]
        if len(set(row)) > 1 or row[0].order > row[0].bound:
            lines.append(f"| {case} | {' | '.join(f'{one.order} / {one.bound}' for one in row)} |")
    return "\n".join(lines)


def main() -> None:
    """Measure all variants, and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=float, default=2.0)
    parser.add_argument("--write", type=Path)
    arguments = parser.parse_args()
    results = {name: measure(arguments.work, left_out) for name, left_out in _LEFT_OUT.items()}
    text = table(results, arguments.work)
    print(text)
    if arguments.write is not None:
        write_between(arguments.write, text)


if __name__ == "__main__":
    main()
