"""How far a parameter of the two-link arm travels: files, functions, and moves between files.

    python -m benchmarks.moves [--parameter m3] [--pairs 15] [--scene scenarios/two_link_arm.toml]

The scene file is read and made into a certified model (without search) under a tracer. It sees every
call of a function of the package, in order. A *move* is a call in another file than the call before
it: what a reader does who follows the program with a finger. A *function* is a name in a file. Two
files *call each other both ways* if moves go from each to the other. All modules are imported before
the tracer starts, so that what happens at import does not count. Nothing depends on time; Python 3.12
and newer call no function for a comprehension, and show fewer.
"""

import argparse
import importlib
import pkgutil
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import mbdlft

ARM = Path(__file__).parents[1] / "scenarios" / "two_link_arm.toml"
PACKAGE = Path(mbdlft.__file__).parent
TARGET_FILES, TARGET_MOVES = 60, 1500


class Call(NamedTuple):
    """One call: the file, relative to the package, and the name of the function in it."""

    file: str
    name: str


def import_all() -> None:
    """Import every module of the package."""
    for module in pkgutil.walk_packages([str(PACKAGE)], "mbdlft."):
        importlib.import_module(module.name)


def calls_during(action: Callable[[], Any]) -> list[Call]:
    """All calls of functions of the package while an action runs, in their order."""
    found: list[Call] = []
    top = f"{PACKAGE}/"

    def trace(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(top):
            found.append(Call(code.co_filename.removeprefix(top), code.co_name))

    sys.setprofile(trace)
    try:
        action()
    finally:
        sys.setprofile(None)
    return found


def moves_between(calls: Iterable[Call]) -> Counter[tuple[str, str]]:
    """How often a call in the second file comes right after a call in the first file."""
    files = [call.file for call in calls]
    return Counter((before, after) for before, after in pairwise(files) if before != after)


def both_ways(moves: Counter[tuple[str, str]]) -> Counter[tuple[str, str]]:
    """The moves of all pairs of files, both directions together, where both directions occur."""
    return Counter({(a, b): n + moves[b, a] for (a, b), n in moves.items() if a < b and (b, a) in moves})


def figures(calls: list[Call]) -> str:
    """The table with its targets, in Markdown."""
    moves = moves_between(calls)
    files = len({call.file for call in calls})
    rows = [
        ("files", files, f"<= {TARGET_FILES}", files <= TARGET_FILES),
        ("functions", len(set(calls)), "", True),
        ("moves between files", moves.total(), f"<= {TARGET_MOVES}", moves.total() <= TARGET_MOVES),
        ("pairs of files that call each other both ways", len(both_ways(moves)), "", True),
    ]
    lines = [f"| {what} | {target} | {n}{'' if met else ' (missed)'} |" for what, n, target, met in rows]
    return "\n".join(["| what | target | measured |", "|---|---|---|", *lines])


def busiest(calls: list[Call], count: int) -> str:
    """Pairs of files with most moves, and the functions that the moves of each arrive at."""
    together: Counter[tuple[str, str]] = Counter()
    arrivals: dict[tuple[str, str], Counter[str]] = {}
    for before, after in pairwise(calls):
        if before.file != after.file:
            a, b = sorted([before.file, after.file])
            together[a, b] += 1
            arrivals.setdefault((a, b), Counter())[f"{Path(after.file).stem}.{after.name}"] += 1
    lines = ["| moves | between | and | most often to |", "|---|---|---|---|"]
    for (a, b), n in together.most_common(count):
        to = ", ".join(f"`{name}` {k}" for name, k in arrivals[a, b].most_common(4))
        lines.append(f"| {n} | {a} | {b} | {to} |")
    return "\n".join(lines)


def main() -> None:
    """Trace, and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=Path, default=ARM)
    parser.add_argument("--parameter", default="m3")
    parser.add_argument("--pairs", type=int, default=15)
    options = parser.parse_args()
    import_all()
    models: list[mbdlft.LFTModel] = []
    load, make = mbdlft.load_scene, mbdlft.to_lft  # what is looked up is imported
    calls = calls_during(lambda: models.append(make(load(options.scene), search=0.0)))
    (model,) = models
    if options.parameter not in [parameter.name for parameter in model.parameters]:
        parser.error(f"'{options.parameter}' is no parameter of {options.scene}.")
    print(f"{options.parameter} of {options.scene.name}, from its file to the certified model:\n")
    print(f"{figures(calls)}\n\n{busiest(calls, options.pairs)}")


if __name__ == "__main__":
    main()
