"""Seconds and sizes of the pages that `view` and `report` write, for every scenario.

Run it from the top of the repository: python -m benchmarks.pages [SCENARIO ...]

The seconds are those of a whole process, and of the processor, as a machine with other work needs longer.
"""

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

SCENARIOS = Path(__file__).parents[1] / "scenarios"
SECONDS, MEGABYTES = 3.0, 6.0  # targets
_RUN = "import sys; from mbdlft.cli.commands import main; main()"


class Page(NamedTuple):
    """A page: seconds of the clock and of the processor, and megabytes."""

    seconds: float
    processor: float
    size: float


def page(command: str, source: Path, folder: Path) -> Page | str:
    """The page of a file, or why there is none."""
    output = folder / f"{command}.html"
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    words = [sys.executable, "-c", _RUN, command, str(source), "-o", str(output)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if done.returncode:
        return done.stderr.strip().splitlines()[-1][:90]
    return Page(seconds, processor, output.stat().st_size / 1e6)


def table(names: Iterable[str]) -> str:
    """A row for each scenario: seconds of the processor and megabytes of both pages."""
    lines = ["| scenario | view, s | MB | report, s | MB |", "|---|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            cells = []
            for command in ("view", "report"):
                found = page(command, SCENARIOS / name, Path(folder))
                if isinstance(found, str):
                    cells += [found, ""]
                    continue
                late = " (missed)" if found.processor > SECONDS or found.size > MEGABYTES else ""
                cells += [f"{found.processor:.1f}{late}", f"{found.size:.1f}"]
            lines.append(f"| `{Path(name).stem}` | {' | '.join(cells)} |")
            print(lines[-1], flush=True)
    return "\n".join(lines)


if __name__ == "__main__":
    chosen = sys.argv[1:] or sorted(path.name for path in SCENARIOS.glob("*.toml"))
    table(chosen)
