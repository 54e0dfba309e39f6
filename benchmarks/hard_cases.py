"""Hard cases: errors against 50 digits, beside the condition of the problem.

    python -m benchmarks.hard_cases [--small] [--write docs/hard-cases.md]

Nothing is printed unless every error is within a small factor of condition times eps, and of what the
certificate of the model states: its error, or its condition.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from benchmarks.arm import machine, write_between
from benchmarks.cases.hard import CASES, LARGE, Case
from benchmarks.cases.measure import Errors, measure
from benchmarks.targets import HARD, HARD_NUMERIC


def verified(case: Case) -> Errors:
    """The errors of a case; the program ends if its condition does not explain one."""
    found = measure(case)
    explained = found.lft_factor <= HARD and found.numeric_factor <= HARD_NUMERIC
    if not (explained and found.unstated <= HARD):
        raise SystemExit(f"{case.name}: the error is larger than the condition explains: {found}")
    print(json.dumps({"case": case.name} | found._asdict()), flush=True)
    return found


def table(cases: Sequence[Case]) -> str:
    """One row for each case."""
    lines = [
        "| case | states | order | condition | error of the LFT | times condition eps "
        "| error of the numeric linearization | times condition eps "
        "| certificate: error | condition | sign changes |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for case in cases:
        e = verified(case)
        lines.append(
            f"| {case.name} | {e.states} | {e.order} | {e.condition:.1e} | {e.lft:.1e} "
            f"| {e.lft_factor:.2g} | {e.numeric:.1e} | {e.numeric_factor:.2g} "
            f"| {e.certified:.1e} | {e.stated:.1e} | {e.sign_changes} |"
        )
    return "\n".join([*lines, "", machine()])


def main() -> None:
    """Print the table, and write it into a page between its two marks if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--small", action="store_true", help="without the cases that take minutes")
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    text = table(CASES if options.small else [*CASES, *LARGE])
    print(text)
    if options.write:
        write_between(options.write, text)


if __name__ == "__main__":
    main()
