"""Tables of the command line, scene files that it writes, and the table of an equilibrium."""

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
from mbdlft.cli.notes import WARNINGS

if TYPE_CHECKING:
    from mbdlft.multibody.equilibrium import EquilibriumPoint
    from mbdlft.multibody.scene import Scene

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
