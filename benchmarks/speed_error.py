"""Seconds per model against error: this package, other tools and common practice on four systems.

    python -m benchmarks.speed_error [--samples N] [--lines FILE] [--write PAGE] [--figure PICTURE]

The same random values of the parameters for all; errors are against 50-digit arithmetic. A method whose
error is above what it promises ends the program before anything is timed. Seconds are those of
the processor in one thread, medians of rounds in which all methods take turns.
"""

import argparse
import json
import re
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.arm import machine, write_between
from benchmarks.speed.methods import CANDIDATES, FITTED, Candidate, made
from benchmarks.speed.own import whole
from benchmarks.speed.picture import figure
from benchmarks.speed.robots import Method
from benchmarks.speed.systems import System, systems
from benchmarks.speed.truth import Truth, entry_errors, pole_errors, truth

SAMPLES, PROOFS, ROUNDS = 10_000, 200, 5
TARGET_SECONDS, TARGET_ERROR = 1e-6, 1e-14  # of the LFT of the arm
MANY, QUICK = (
    1_000_000,
    10e-6,
)  # samples of the last column, and seconds per model: slower ones take minutes
CALL_BYTES = 5e8  # of the values of a call
COMPILED = "mbdlft, equations compiled"
_ROUNDING = 1e-9  # 1/s: a smaller real part is that of an undamped pole
Row = dict[str, Any]


@threadpool_limits.wrap(limits=1)
def measured(
    system: System,
    samples: int,
    proofs: int,
    rounds: int,
    candidates: Sequence[Candidate] = CANDIDATES,
    many: int = 0,
) -> list[Row]:
    """One row for each method: its errors, then its time, then that of `many` samples if it is quick.

    Raises
    ------
    SystemExit
        A method is wrong.
    """
    values = system.samples(samples)
    exact = truth(system, values, proofs)
    common: Row = {"system": system.name, "states": exact.states, "samples": samples}
    common |= {"parameters": len(values), "proofs": len(exact.subset), "proved": exact.proved}
    common["pole_rounding"] = rounding_of_poles(exact)
    rows: list[Row] = []
    ready: list[tuple[Row, Method, float]] = []
    for candidate in candidates:
        start = time.perf_counter()  # a compiler is another process
        method = made(candidate, system)
        build = time.perf_counter() - start
        rows.append(common | {"method": candidate.name})
        if isinstance(method, str):
            rows[-1]["reason"] = method
            continue
        start = time.process_time()
        found = method(values)
        first = time.process_time() - start
        rows[-1] |= {"build_seconds": build} | errors(candidate, whole(found), exact)
        ready.append((rows[-1], method, first))
    seconds: dict[str, list[float]] = {row["method"]: [] for row, *_ in ready}
    for _ in range(rounds):
        for row, method, _ in ready:
            start = time.process_time()
            method(values)
            seconds[row["method"]].append(time.process_time() - start)
    for row, method, first in ready:
        each = median(seconds[row["method"]])
        row["seconds_per_model"] = each / samples
        row["build_seconds"] += max(0.0, first - each)  # what is made when it is first asked for
        if many and row["seconds_per_model"] <= QUICK:
            row |= {"many": many, "seconds_of_many": of_many(method, system, many, exact.values)}
    return rows


def of_many(method: Method, system: System, many: int, values: np.ndarray) -> float:
    """Seconds per model of many samples, in calls as long as memory allows; the first is not timed."""
    size = 8 * int(np.prod(values.shape[1:]))
    call = next(n for n in (10**6, 10**5, 10**4, 10**3, 1) if n * size <= CALL_BYTES or n == 1)
    call = min(call, many)
    drawn = system.samples(many, seed=1)
    method({name: column[:call] for name, column in drawn.items()})
    start = time.process_time()
    for first in range(0, many, call):
        method({name: column[first : first + call] for name, column in drawn.items()})
    return (time.process_time() - start) / many


def errors(candidate: Candidate, found: np.ndarray, exact: Truth) -> Row:
    """Errors of entries and poles; the pole farthest to the right, and by how much one is missed."""
    poles = np.linalg.eigvals(found[:, : exact.states, : exact.states])
    own, of_poles = entry_errors(found, exact), pole_errors(poles, exact)
    worst = max(float(np.max(own)), float(np.max(of_poles)))
    if not worst <= candidate.accepted:
        raise SystemExit(f"{candidate.name} is wrong: error {worst:.1e}; no times are printed.")
    return {
        "error": max(float(np.max(own)), exact.proved),
        "error_median": max(float(np.median(own)), exact.proved),
        "pole_error": max(float(np.max(of_poles)), exact.proved),
        "rightmost_pole": float(np.max(exact.rightmost)),
        "rightmost_pole_missed": float(np.max(exact.rightmost - np.max(poles.real, axis=1))),
    }


def rounding_of_poles(exact: Truth) -> float:
    """Largest error of a pole of the true A, rounded to double precision: that of the routine."""
    A = exact.values[:, : exact.states, : exact.states].astype(float)
    return float(np.max(pole_errors(np.linalg.eigvals(A), exact)))


def beaten(rows: Sequence[Row], own: Sequence[str]) -> list[str]:
    """General tools that are faster and more accurate, on one system, than each of some methods.

    More accurate: in the entries, or in the poles by more than their rounding.
    """
    by_name = {row["method"]: row for row in rows if "error" in row}
    mine = [by_name[name] for name in own if name in by_name]

    def better(row: Row, r: Row) -> bool:
        poles = row["pole_error"] + row["pole_rounding"] < r["pole_error"]
        faster = row["seconds_per_model"] < r["seconds_per_model"]
        return bool(faster and (row["error"] < r["error"] or poles))

    others = [c.name for c in CANDIDATES if c.general and not c.own and c.name in by_name]
    return [name for name in others if mine and all(better(by_name[name], r) for r in mine)]


def table(rows: Sequence[Row]) -> str:
    """All rows in Markdown, what the fits miss, and whether the targets are met."""
    lines = [
        f"| system | method | microseconds per model | of {max(r.get('many', 0) for r in rows)} "
        "| largest error of an entry | its median | largest error of a pole | seconds to prepare |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        head = f"| {r['system']} | {r['method']} "
        if "error" not in r:
            lines.append(f"{head}| - | - | {r['reason']} | - | - | - |")
            continue
        lines.append(
            f"{head}| {1e6 * r['seconds_per_model']:.3g} | {of_many_text(r)} "
            f"| {r['error']:.1e} | {r['error_median']:.1e} | {r['pole_error']:.1e} "
            f"| {r['build_seconds']:.2g} |"
        )
    lines += ["", *missed(rows), "", *verdicts(rows), "", machine()]
    return "\n".join(lines)


def of_many_text(row: Row) -> str:
    """Microseconds per model of many samples, or a dash."""
    return f"{1e6 * row['seconds_of_many']:.3g}" if "many" in row else "-"


def groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows by system."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row["system"], []).append(row)
    return found


def missed(rows: Sequence[Row]) -> list[str]:
    """How much too slow the fits say that the fastest unstable pole is; what was proved about errors."""
    present = {row["method"] for row in rows}
    fits = [c.name for c in CANDIDATES if c.accepted == FITTED and c.name in present]
    lines = [
        "| system | largest real part of a pole over the samples (1/s) | "
        + " | ".join(f"{fit}: too small by up to" for fit in fits)
        + " | 50 digits computed at | 80 bits differ there by | poles of the true A, rounded |",
        "|" + "---|" * (5 + len(fits)),
    ]
    for name, group in groups(rows).items():
        by_name = {r["method"]: r for r in group if "error" in r}
        first = next(iter(by_name.values()))
        worst = [by_name[fit]["rightmost_pole_missed"] if fit in by_name else 0.0 for fit in fits]
        cells = [f"{x:.2g}" if x > _ROUNDING else "-" for x in worst]
        lines.append(
            f"| {name} | {first['rightmost_pole']:.3g} | {' | '.join(cells)} "
            f"| {first['proofs']} samples | {first['proved']:.0e} | {first['pole_rounding']:.1e} |"
        )
    return lines


def verdicts(rows: Sequence[Row]) -> list[str]:
    """Which general tools are both faster and more accurate; the target of the arm."""
    lines = []
    own = [c.name for c in CANDIDATES if c.own]
    for title, names in [("all ways of this package", own), *((f"`{n}`", [n]) for n in own)]:
        found = [f"{', '.join(b)} ({s})" for s, g in groups(rows).items() if (b := beaten(g, names))]
        lines.append(f"- Faster and more accurate than {title}: {'; '.join(found) or 'none'}.")
    lines += against_c(rows)
    arm = next((r for r in rows if r["method"] == own[0] and r["system"] == "two-link arm"), None)
    if arm is not None:
        us, error = 1e6 * arm["seconds_per_model"], arm["error"]
        met = us <= 1e6 * TARGET_SECONDS and error <= TARGET_ERROR
        lines.append(
            f"- LFT of the arm: {us:.2f} us per sample and error {error:.1e}; target "
            f"{1e6 * TARGET_SECONDS:g} us and {TARGET_ERROR:.0e}: {'met' if met else 'missed'}."
        )
    return lines


def against_c(rows: Sequence[Row]) -> list[str]:
    """Times of native code in those of both kinds of C, by system."""
    lines = []
    for name, group in groups(rows).items():
        seconds = {r["method"]: r["seconds_per_model"] for r in group if "error" in r}
        ratios = [
            f"{seconds[COMPILED] / seconds[c]:.2f} of {c}"
            for c in ("plain C", "vectorized C")
            if {c, COMPILED} <= seconds.keys()
        ]
        if ratios:
            lines.append(f"- {name}, `{COMPILED}`: {', '.join(ratios)}.")
    return lines


def merged(rows: Sequence[Row], lines: Path) -> list[Row]:
    """Rows that were measured, and those of the other methods of a file, in the order of the methods."""
    order = [c.name for c in CANDIDATES]
    earlier = [json.loads(line) for line in lines.read_text(encoding="utf-8").splitlines()]
    by_key = {(r["system"], r["method"]): r for r in [*earlier, *rows] if r["method"] in order}
    names = list(groups(earlier))
    return sorted(by_key.values(), key=lambda r: (names.index(r["system"]), order.index(r["method"])))


def json_lines(rows: Sequence[Row]) -> str:
    """One line for each system and method."""
    return "".join(json.dumps(row) + "\n" for row in rows)


def main() -> None:
    """Print the table; write lines, table and figure if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=SAMPLES)
    parser.add_argument("--many", type=int, default=MANY, help="0: none")
    parser.add_argument("--only", help="a part of the name of a system")
    parser.add_argument("--methods", help="a pattern of their names; the lines of the others stay")
    parser.add_argument("--proofs", type=int, default=PROOFS)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--lines", type=Path, default=Path("docs/speed-error.jsonl"))
    parser.add_argument("--write", type=Path)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    measured_rows: list[Row] = []
    candidates = [c for c in CANDIDATES if re.search(options.methods or "", c.name)]
    for system in (one for one in systems() if (options.only or "") in one.name):
        measured_rows += measured(
            system, options.samples, options.proofs, options.rounds, candidates, options.many
        )
    rows = merged(measured_rows, options.lines) if options.methods else measured_rows
    options.lines.write_text(json_lines(rows), encoding="utf-8")
    text = table(rows)
    print(text)
    if options.write:
        write_between(options.write, text)
    if options.figure:
        figure(options.figure, groups(rows))


if __name__ == "__main__":
    main()
