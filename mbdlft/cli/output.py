"""What commands print: tables, JSON, warnings, their progress, equilibria; and scenes that they write."""

import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from mbdlft.base.errors import MbdlftError, SceneError
from mbdlft.base.parameter import Parameter

if TYPE_CHECKING:
    from mbdlft.multibody.equilibrium import EquilibriumPoint
    from mbdlft.multibody.scene import Scene
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.markup import escape
from rich.status import Status

from mbdlft.base.running import heard

_WIDTH = 110  # characters in a line of a table that goes into a file or a pipe
_GROWS = 1e-6  # a real part below this part of the largest eigenvalue is zero


def console() -> Console:
    """The console for standard output; it prints texts of scenes as they are, not as markup."""
    return Console(width=None if sys.stdout.isatty() else _WIDTH, markup=False, emoji=False)


def table(title: str | None, *headings: str) -> Table:
    """An empty table; a heading that ends in ``>`` makes a column of numbers."""
    rows = Table(title=Text(title) if title else None)
    for heading in headings:
        number = heading.endswith(">")
        rows.add_column(heading.rstrip(" >"), justify="right" if number else "left")
    return rows


def print_json(found: object) -> None:
    """Print plain data as one JSON object, with the warnings that the command has shown."""
    if isinstance(found, dict):
        found = {**found, "warnings": list(WARNINGS)}
    sys.stdout.write(json.dumps(found, indent=2, ensure_ascii=False) + "\n")


def parameters_data(parameters: Iterable[Parameter]) -> list[dict[str, object]]:
    """Parameters as plain data."""
    keys = ("name", "unit", "low", "nominal", "high", "role")
    return [{key: getattr(p, key) for key in keys} for p in parameters]


def print_files(*files: tuple[str, Path], as_json: bool) -> None:
    """Print what files were written, each with what it is."""
    if as_json:
        print_json({"files": [str(path) for _, path in files]})
        return
    for what, path in files:
        console().print(f"{what}: {path}", soft_wrap=True)


def print_equilibria(
    scene: "Scene",
    values: Mapping[str, float],
    starts: int,
    output: Path | None,
    *,
    every: bool,
    as_json: bool,
) -> None:
    """Find one equilibrium, or `every` one to which `starts` lead; write the scene at the first one."""
    from mbdlft.multibody.equilibrium import at_equilibrium, find_equilibrium

    if every:
        points = find_equilibrium(scene, values, starts=starts, every=True)
    else:
        points = (find_equilibrium(scene, values, starts=starts),)
    if output is not None:
        write_scene(output, at_equilibrium(scene, points[0]))
    if as_json:
        print_json({"name": scene.name, "equilibria": [_as_data(scene, point) for point in points]})
        return
    out = console()
    for k, point in enumerate(points, start=1):
        rows = table(f"{scene.name}: equilibrium {k}", "unknown", "value >", "unit")
        for name, value in {**point.positions, **point.efforts}.items():
            rows.add_row(name, f"{value:.10g}", point.units[name])
        out.print(rows)
        out.print(f"residual {point.residual:.1e} of the largest terms; {_stability(scene, point)}")
        if point.undetermined:
            out.print(f"not determined: {', '.join(point.undetermined)}")
    if output is not None:
        out.print(f"scene: {output}", soft_wrap=True)


def _as_data(scene: "Scene", point: "EquilibriumPoint") -> dict[str, object]:
    """An equilibrium as plain data."""
    found = {**point.positions, **point.efforts}
    return {
        "found": [
            {"name": name, "value": value, "unit": point.units[name]}
            for name, value in found.items()
        ],
        "residual": point.residual,
        "stability": _stability(scene, point),
        "not determined": list(point.undetermined),
    }


def write_scene(path: Path, scene: "Scene") -> None:
    """Write a scene as a TOML file."""
    from mbdlft.multibody.scene import scene_to_toml

    try:
        path.write_text(scene_to_toml(scene), encoding="utf-8")
    except OSError as error:
        raise SceneError(f"{path}: cannot be written: {error.strerror}.") from None


def _stability(scene: "Scene", point: "EquilibriumPoint") -> str:
    """A sentence that says whether an equilibrium is stable."""
    from mbdlft.multibody.equilibrium import eigenvalues_at

    try:
        eigenvalues = eigenvalues_at(scene, point)
    except MbdlftError as error:
        return f"stability not known: {error}"
    real, largest = float(eigenvalues[0].real), float(max(abs(eigenvalues)))
    if abs(real) <= _GROWS * largest:
        return "neither stable nor unstable: something moves without damping"
    if real > 0.0:
        return f"unstable: grows with {real:.3g} rad/s"
    return f"stable: decays with {-real:.3g} rad/s"


WARNINGS: list[str] = []  # that this command has shown


def warn(message: object) -> None:
    """Show a warning: one line beside the output."""
    WARNINGS.append(str(message))
    sys.stderr.write(f"mbdlft: warning: {message}\n")


_OFTEN = 0.1  # s between two looks
_KNOWN = 1.0  # s after which the time that is left is guessed


class Progress:
    """A line that says how far a command is.

    Parameters
    ----------
    name : of what is worked on
    status : Status
        Where it is shown.
    """

    def __init__(self, name: str, status: Status) -> None:
        self.name, self._status = name, status
        self._stage, self._rest = "", ""
        self._begun = self._shown = 0.0
        self._first = self._done = self._most = 0.0

    def stage(self, stage: str) -> None:
        """Another stage begins."""
        self._stage, self._rest, self._most = stage, "", 0.0
        self._show()

    def bounds(self, low: float, high: float) -> None:
        """What is sought is between two numbers."""
        self._stage = f"{low:.4g} to {high:.4g}"
        self._show()

    def worked(self, done: float, most: float) -> None:
        """So many units of a budget are done; it may not be used up."""
        if self._counted(done, most):
            share = f"{100.0 * self._done / most:.0f} % of the work that is allowed"
            left = self._left()
            self._rest = f", {share}" + (f", at most {left}" if left else "")
            self._show()

    def counted(self, done: int, count: int) -> None:
        """So many of so many pieces are done."""
        if self._counted(done, count):
            left = self._left()
            self._rest = f", {done} of {count}" + (f", {left}" if left else "")
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
        self._status.update(escape(f"{self.name}{stage}{self._rest}"))


@contextmanager
def progress_of(name: str) -> Iterator[Progress]:
    """A line on stderr that says how far the work inside is; nothing where stderr is no terminal."""
    with Console(stderr=True).status(escape(name)) as status:
        progress = Progress(name, status)
        with heard(progress.worked):
            yield progress


def time_left(seconds: float, done: float, count: float) -> str:
    """Words on the time that the rest takes, if it goes on as in the first `seconds`; none before that.

    `done` of `count` pieces took these seconds.
    """
    if not 0.0 < done < count:
        return ""
    left = round(seconds * (count - done) / done)
    if left < 60:
        return f"about {left} s left"
    minutes, hours = left // 60, left // 3600
    return (
        f"about {minutes} min left" if left < 3600 else f"about {hours} h {minutes % 60} min left"
    )
