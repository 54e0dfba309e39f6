"""What commands print: tables, lines, JSON, their progress; and scenes that they write."""

import json
import math
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.status import Status
from rich.table import Table
from rich.text import Text

from mbdlft import base, multibody
from mbdlft.base.errors import SceneError
from mbdlft.base.running import heard
from mbdlft.cli.commands import WARNINGS

_WIDTH = 110  # characters in a line of a table that goes into a file or a pipe
_OFTEN = 0.1  # s between two looks
_RARELY = 20.0  # s between two lines that go into a file or a pipe
_KNOWN = 1.0  # s after which the time that is left is guessed


def console() -> Console:
    """The console for standard output; it prints texts of scenes as they are, not as markup."""
    return Console(width=None if sys.stdout.isatty() else _WIDTH, markup=False, emoji=False)


def say(*lines: str) -> None:
    """Print lines as they are; a terminal folds long ones."""
    for line in lines:
        console().print(line, soft_wrap=True, highlight=False)


def print_table(
    title: str | None, headings: str, rows: Iterable[Sequence[str]], footer: Sequence[str] = ()
) -> None:
    """Print a table; its headings stand between bars, and one that ends in ``>`` is of numbers."""
    table = Table(title=Text(title) if title else None, show_footer=bool(footer))
    names = headings.split(" | ")
    for name, below in zip(names, footer or [""] * len(names), strict=True):
        justify: Any = "right" if name.endswith(">") else "left"
        table.add_column(name.rstrip(" >"), justify=justify, footer=below)
    for row in rows:
        table.add_row(*row)
    console().print(table)


def print_parameters(parameters: "Sequence[base.Parameter]") -> None:
    """A table of parameters, if there are any."""
    if parameters:
        numbers = ((f"{p.low:g}", f"{p.nominal:g}", f"{p.high:g}") for p in parameters)
        rows = ((p.name, p.unit, *n, p.role) for p, n in zip(parameters, numbers, strict=True))
        print_table("parameters", "name | unit | low > | nominal > | high > | role", rows)


def print_json(data: object) -> None:
    """Print plain data as one JSON object, with the warnings that the command has shown."""
    if isinstance(data, dict):
        data = {**data, "warnings": list(WARNINGS)}
    sys.stdout.write(json.dumps(_plain(data), indent=2, ensure_ascii=False) + "\n")


def _plain(data: Any) -> Any:
    """Data as JSON has it: null for inf and NaN, which it has not."""
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: _plain(value) for key, value in data.items()}
    return [_plain(value) for value in data] if isinstance(data, list | tuple) else data


def parameters_data(parameters: "Iterable[base.Parameter]") -> list[dict[str, Any]]:
    """Parameters as plain data."""
    keys = ("name", "unit", "low", "nominal", "high", "role")
    return [{key: getattr(p, key) for key in keys} for p in parameters]


def signals_data(model: Any) -> dict[str, list[dict[str, str]]]:
    """States, inputs and outputs of a model as plain data."""

    return {
        what: [{"name": signal.name, "unit": signal.unit} for signal in getattr(model, what)]
        for what in ("states", "inputs", "outputs")
    }


def print_files(*files: tuple[str, Path], as_json: bool) -> None:
    """Print what files were written, each with what it is."""
    if as_json:
        print_json({"files": [str(path) for _, path in files]})
        return
    say(*(f"{what}: {path}" for what, path in files))


def write_text(path: Path, text: str) -> None:
    """Write a text into a file."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise SceneError(f"{path}: cannot be written: {error.strerror or error}.") from None


def write_scene(path: Path, scene: "multibody.Scene") -> None:
    """Write a scene as a TOML file."""
    write_text(path, multibody.scene_to_toml(scene))


class Progress:
    """A line on stderr of a terminal: the stage of `name`, what is done of a budget, the time left."""

    def __init__(self, name: str, status: "Status | Lines") -> None:
        self.name, self._status = name, status
        self._stage, self._count = "", ""
        self._begun = self._shown = 0.0
        self._first = self._done = self._most = 0.0

    def stage(self, stage: str) -> None:
        """Another stage begins."""
        self._stage, self._count, self._most = stage, "", 0.0
        self._show()

    def bounds(self, low: float, high: float) -> None:
        """What is sought is between two numbers."""
        self._stage = f"{low:.4g} to {high:.4g}"
        self._show()

    def worked(self, done: float, most: float) -> None:
        """So many units of a budget are done; it may not be used up."""
        if self._counted(done, most):
            share = f"{100.0 * self._done / most:.0f} % of the work that is allowed"
            time = self._left()
            self._count = f", {share}" + (f", at most {time}" if time else "")
            self._show()

    def counted(self, done: int, count: int) -> None:
        """So many of so many pieces are done."""
        if self._counted(done, count):
            time = self._left()
            self._count = f", {done} of {count}" + (f", {time}" if time else "")
            self._show()

    def _counted(self, done: float, most: float) -> bool:
        """Whether it is time to show a count; one of another budget begins anew."""
        now = time.monotonic()
        if most != self._most or done < self._first:
            self._begun, self._first, self._done, self._most = now, done, done, most
        self._done = max(self._done, done)
        if now < self._shown + _OFTEN and done < most:
            return False
        self._shown = now
        return True

    def _left(self) -> str:
        seconds = time.monotonic() - self._begun
        if seconds < _KNOWN:
            return ""
        return time_left(seconds, self._done - self._first, self._most - self._first)

    def _show(self) -> None:
        stage = f": {self._stage}" if self._stage else ""
        self._status.update(escape(f"{self.name}{stage}{self._count}"))


class Lines:
    """What is shown in a file or a pipe, in place of a status of rich: a line now and then."""

    def __init__(self) -> None:
        self._shown = time.monotonic()

    def update(self, text: str) -> None:
        """Show a text, unless another one was shown lately."""
        if time.monotonic() >= self._shown + _RARELY:
            self._shown = time.monotonic()
            Console(stderr=True).print(text, soft_wrap=True, highlight=False)


@contextmanager
def progress_of(name: str) -> Iterator[Progress]:
    """A line on stderr that says how far the work inside is; of long work also where it is a file."""
    console = Console(stderr=True)
    with console.status(escape(name)) if console.is_terminal else nullcontext(Lines()) as status:
        progress = Progress(name, status)
        with heard(progress.worked):
            yield progress


def time_left(seconds: float, done: float, count: float) -> str:
    """Words on the time for the other pieces, if `done` of `count` took these seconds; none at first."""
    if not 0.0 < done < count:
        return ""
    seconds_left = round(seconds * (count - done) / done)
    if seconds_left < 60:
        return f"about {seconds_left} s left"
    minutes, hours = seconds_left // 60, seconds_left // 3600
    return (
        f"about {minutes} min left" if seconds_left < 3600 else f"about {hours} h {minutes % 60} min left"
    )
