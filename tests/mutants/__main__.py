"""Plant each bug of `planted/` in a copy of the repository, and see that its tests fail.

    python -m tests.mutants [--only WORD] [--jobs N] [--no-baseline]

A bug is a text that occurs once in a file of the package, and what takes its place. It is *killed* if
its tests run and one of them fails; it *survived* if they pass. Everything else is an error: a text that
is no longer found or is found twice, a program that cannot be imported, a test that does not exist.
First all named tests are run without any bug: they must pass.

A room of the package has one list, `planted/ROOM.toml`, with a table for each of its files:

    ["room/file.py"]
    tests = "tests that must fail, below tests/"
    bugs = [
      ['text', 'replacement'],
      ['text', 'replacement', 'other tests'],
    ]

Where a text has changed, follow it; where a bug is no bug any more, take it out.
"""

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from importlib.util import cache_from_source
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
LISTS = Path(__file__).with_name("planted")
COPIED = ("bodies", "benchmarks", "docs", "mbdlft", "scenarios", "tests")
LOOSE = ("README.md", "pyproject.toml")
KILLED, SURVIVED = "killed", "survived"
_OUTCOMES = {0: SURVIVED, 1: KILLED}  # exit codes of pytest; others are errors


class Bug(NamedTuple):
    """One planted bug: a file of the package, a text in it, its replacement, and tests (of tests/)."""

    file: str
    old: str
    new: str
    tests: str


class Outcome(NamedTuple):
    """What became of a bug; `detail` is the first test that failed, or what went wrong."""

    bug: Bug
    verdict: str
    detail: str


def planted() -> list[Bug]:
    """All bugs of the lists, in their order."""
    return [
        Bug(file, old, new, tests[0] if tests else entry["tests"])
        for path in sorted(LISTS.glob("*.toml"))
        for file, entry in tomllib.loads(path.read_text(encoding="utf-8")).items()
        for old, new, *tests in entry["bugs"]
    ]


def copy_to(folder: Path) -> None:
    """A copy of what tests need, without what Python and hypothesis leave behind."""
    for name in COPIED:
        left_out = shutil.ignore_patterns("__pycache__", ".hypothesis")
        shutil.copytree(ROOT / name, folder / name, ignore=left_out)
    for name in LOOSE:
        shutil.copy(ROOT / name, folder / name)


def run_tests(folder: Path, tests: Iterable[str], *more: str) -> tuple[int, str]:
    """Exit code and last lines of pytest in a copy."""
    chosen = [part for text in tests for part in shlex.split(text)]
    chosen = [f"tests/{part}" if part.partition("::")[0].endswith(".py") else part for part in chosen]
    command = [sys.executable, "-m", "pytest", "-q", "-x", "--tb=no", "-p", "no:cacheprovider"]
    found = subprocess.run(
        [*command, *more, *chosen],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    return found.returncode, found.stdout


def outcome(folder: Path, bug: Bug) -> Outcome:
    """Plant a bug in a copy, run its tests, and take it out again."""
    file = folder / "mbdlft" / bug.file
    if not file.exists():
        return Outcome(bug, "error", "the file is not there")
    text = file.read_text(encoding="utf-8")
    count = text.count(bug.old)
    if count != 1:
        return Outcome(bug, "error", f"the text occurs {count} times in the file, expected once")
    compiled = Path(cache_from_source(str(file)))  # told from the file by its size and second only
    try:
        compiled.unlink(missing_ok=True)
        file.write_text(text.replace(bug.old, bug.new), encoding="utf-8")
        code, output = run_tests(folder, [bug.tests])
    finally:
        file.write_text(text, encoding="utf-8")
        compiled.unlink(missing_ok=True)
    failed = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
    last = failed[0] if failed else (output.splitlines() or [""])[-1]
    return Outcome(bug, _OUTCOMES.get(code, "error"), last)


def outcomes(bugs: list[Bug], jobs: int, *, baseline: bool) -> list[Outcome]:
    """What became of each bug; copies are used in turn."""
    with tempfile.TemporaryDirectory() as top, ThreadPoolExecutor(jobs) as pool:
        copies: SimpleQueue[Path] = SimpleQueue()
        for k in range(jobs):
            copy_to(Path(top) / str(k))
            copies.put(Path(top) / str(k))
        if baseline:
            tests = dict.fromkeys(bug.tests for bug in bugs)
            code, output = run_tests(Path(top) / "0", tests, "--numprocesses", str(jobs))
            if code != 0:
                raise SystemExit(f"without a bug the tests do not pass:\n{output}")

        def one(bug: Bug) -> Outcome:
            folder = copies.get()
            try:
                found = outcome(folder, bug)
            finally:
                copies.put(folder)
            print(f"{found.verdict:8} {bug.file}: {bug.old} -> {bug.new}", flush=True)
            return found

        return list(pool.map(one, bugs))


def main() -> None:
    """Run all, print the table, and fail if a bug survived or could not be planted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="bugs whose file or text has this word")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--no-baseline", action="store_true", help="do not run without bugs first")
    options = parser.parse_args()
    bugs = [bug for bug in planted() if options.only in f"{bug.file} {bug.old}"]
    if not bugs:
        parser.error(f"no bug has {options.only!r} in its file or text.")
    found = outcomes(bugs, options.jobs, baseline=not options.no_baseline)
    print("\nby room:")
    rooms = Counter((each.bug.file.partition("/")[0], each.verdict) for each in found)
    for (room, verdict), count in sorted(rooms.items()):
        print(f"  {room:10} {verdict:8} {count}")
    left = [each for each in found if each.verdict != KILLED]
    for each in left:
        print(f"\n{each.verdict}: mbdlft/{each.bug.file}\n  - {each.bug.old}\n  + {each.bug.new}")
        print(f"  {each.bug.tests}: {each.detail}")
    print(f"\n{len(found) - len(left)} of {len(found)} bugs are killed.")
    raise SystemExit(1 if left else 0)


if __name__ == "__main__":
    main()
