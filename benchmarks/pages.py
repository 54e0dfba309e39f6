"""Pages that `view` and `report` write of every scenario: seconds, sizes, and what a browser says.

Run it from the top of the repository:

    python -m benchmarks.pages [NAME ...] [--site FOLDER]

The seconds are those of the processor, as a machine with other work needs longer: for the whole process
that writes a page, and for the page in the browser until its first frame, without what the graphics do.
With Chromium each page is opened: messages in its console, files that it misses and requests to the
network are complaints. `--site` opens the pages of `make docs`, too. The exit code is 1 if a page is
missed or complains.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from operator import gt
from pathlib import Path
from typing import NamedTuple

from benchmarks.cases.browser import Loaded, browser, chromium

SCENARIOS = Path(__file__).parents[1] / "scenarios"
SECONDS, OPENED, MEGABYTES = 3.0, 2.0, 6.0  # targets
_REPORTED_ONLY = "mbdlft-matrix"  # nothing to be seen in space
_DRAWN = "() => window.mbdlft && mbdlft.drawn ? mbdlft.drawn() : 1"  # an element may have this name
Load = Callable[[Path], Loaded]


class Page(NamedTuple):
    """Seconds of the processor for a page, megabytes, seconds to open it, complaints of the browser."""

    seconds: float
    size: float
    opening: float
    complaints: tuple[str, ...]

    @property
    def missed(self) -> bool:
        """Whether it takes too long, is too large, or complains."""
        found = (self.seconds, self.opening, self.size)
        return any(map(gt, found, (SECONDS, OPENED, MEGABYTES))) or bool(self.complaints)

    def cells(self) -> list[str]:
        """The cells of a table."""
        found = (self.seconds, self.opening, self.size)
        limits = (SECONDS, OPENED, MEGABYTES)
        return [
            *(f"{x:.1f}" + " (missed)" * (x > most) for x, most in zip(found, limits, strict=True)),
            "; ".join(self.complaints) or "none",
        ]


def page(command: str, source: Path, folder: Path, load: Load | None) -> Page | str:
    """The page of a file, or why there is none."""
    output = folder / f"{command}.html"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-m", "mbdlft", command, str(source), "-o", str(output)]
    # as for a user: modules are compiled once
    around = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=around)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        return done.stderr.strip().splitlines()[-1][:90]
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    opening, said = (0.0, ()) if load is None else opened(output, load)
    return Page(seconds, output.stat().st_size / 1e6, opening, said)


def opened(file: Path, load: Load) -> tuple[float, tuple[str, ...]]:
    """The seconds in which a page is opened and drawn, and what it complains about."""
    loaded = load(file)
    if not loaded.run(_DRAWN):
        loaded.complaints.append("nothing is drawn")
    seconds = loaded.seconds()
    loaded.page.close()
    return seconds, tuple(loaded.complaints)


def sources() -> list[Path]:
    """Every scenario: scenes, robots, matrices and Modelica models."""
    return sorted(file for file in SCENARIOS.rglob("*") if file.suffix in (".toml", ".urdf", ".mo"))


def commands(source: Path) -> tuple[str, ...]:
    """What writes a page of a file: a matrix has no place in space."""
    text = source.read_text(encoding="utf-8")
    return ("report",) if _REPORTED_ONLY in text else ("view", "report")


def table(files: Iterable[Path], load: Load | None) -> bool:
    """Print a row for each page; whether all are as they should be."""
    good = True
    print("| scenario | page | s to write | s to open | MB | complaints |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for file in files:
            for command in commands(file):
                found = page(command, file, Path(folder), load)
                cells = [found, "", "", ""] if isinstance(found, str) else found.cells()
                good &= not isinstance(found, str) and not found.missed
                print(f"| `{file.stem}` | {command} | {' | '.join(cells)} |", flush=True)
    return good


def site(folder: Path, load: Load) -> bool:
    """Open all pages of the documentation; print those that complain, and how many there are."""
    pages = sorted(folder.rglob("*.html"))
    wrong = {file: said for file in pages if (said := opened(file, load)[1])}
    for file, said in wrong.items():
        print(f"{file}: {'; '.join(said)}")
    print(f"{len(pages)} pages of {folder}, {len(wrong)} of them with complaints")
    return bool(pages) and not wrong


def main() -> int:
    """The table, and the site."""
    parser = argparse.ArgumentParser(description="Pages of every scenario in a browser.")
    parser.add_argument("names", nargs="*", help="scenarios, such as crane; all by default")
    parser.add_argument("--site", type=Path, help="pages of make docs, such as out/site")
    given = parser.parse_args()
    files = [file for file in sources() if not given.names or file.stem in given.names]
    with ExitStack() as stack:
        program = chromium()
        load = stack.enter_context(browser(program)) if program else None
        if load is None:
            print("There is no Chromium: pages are not opened.")
        good = table(files, load)
        if given.site is not None:
            good &= load is not None and site(given.site, load)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
