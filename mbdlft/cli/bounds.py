"""What commands of analyses share: loops made of files; how bounds are stored and told."""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mbdlft.base.errors import AnalysisError
from mbdlft.cli.progress import progress_of
from mbdlft.cli.source import stored_system
from mbdlft.cli.tables import console, print_json, table

if TYPE_CHECKING:
    from mbdlft.robust.evidence import Bounds
    from mbdlft.system.model import System

_WITH = " with "  # in the name of a loop
Archive = Annotated[Path, typer.Argument(help="Archive, an HDF5 file.")]
Model = Annotated[str | None, typer.Option("--model", help="Model of an archive that has several.")]
Controller = Annotated[
    Path | None,
    typer.Option(
        "--controller", help="Archive or .mat file (A, B, C, D) of a controller: u - K y is closed."
    ),
]
Gap = Annotated[float, typer.Option(help="Part by which the bounds may differ.")]
Work = Annotated[float, typer.Option(help="Units of work, each at most about a second.")]
LeaveOut = Annotated[
    list[str] | None,
    typer.Option("--leave-out", help="State on which nothing else depends; may be repeated."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Rate = Annotated[
    list[str] | None,
    typer.Option(
        "--rate",
        help="NAME=BOUND of how fast a parameter moves, in its unit per second; inf for any motion; "
        "may be repeated. Others are constant.",
    ),
]
Plot = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--plot",
        help="Figure: bounds of mu over frequency, or singular values with the worst case.",
    ),
]
Inputs = Annotated[
    list[str] | None, typer.Option("--input", help="Input; all by default; may be repeated.")
]
Outputs = Annotated[
    list[str] | None, typer.Option("--output", help="Output; all by default; may be repeated.")
]
Workers = Annotated[int, typer.Option("--workers", help="Processes; the result does not change.")]
NoSave = Annotated[bool, typer.Option("--no-save", help="Do not store the result.")]


def loop_of(archive: Path, model: str | None, controller: Path | None) -> "System":
    """The model of an archive, closed through a controller if there is one."""
    from mbdlft.archive.archive import model_names
    from mbdlft.system import as_system, feedback

    names = model_names(archive)
    if model is None:  # loops that were stored beside a model are not meant
        alone = [name for name in names if _WITH not in name]
        model = alone[0] if len(alone) == 1 else None
    system = stored_system(archive, model)
    if controller is None:
        return system
    loop = feedback(system, _controller(controller))
    name = f"{system.name}{_WITH}{controller.stem}"
    if name in names:
        stored = stored_system(archive, name)
        return stored if _same(stored, loop) else as_system(loop, name=name)
    return as_system(loop, name=name)


def _same(a: "System", b: "System") -> bool:
    """Whether two systems have the same numbers and names."""
    import numpy as np

    pairs = ((a.lft.M11, b.lft.M11), (a.lft.M12, b.lft.M12), (a.lft.M21, b.lft.M21))
    same = all(np.array_equal(x, y) for x, y in (*pairs, (a.lft.M22, b.lft.M22)))
    return same and a.parameters == b.parameters and a.inputs == b.inputs and a.outputs == b.outputs


def _controller(file: Path) -> Any:
    """A controller of an archive, or of the matrices A, B, C, D of a .mat file."""
    if file.suffix.lower() != ".mat":
        return stored_system(file, None)
    from scipy.io import loadmat

    from mbdlft.system import state_space

    try:
        matrices = loadmat(file)
    except (OSError, ValueError, NotImplementedError) as error:
        raise AnalysisError(f"{file}: no .mat file that can be read: {error}.") from None
    missing = [name for name in "ABCD" if name not in matrices]
    if missing:
        raise AnalysisError(
            f"{file}: expected the matrices A, B, C, D of a controller; {', '.join(missing)} missing."
        )
    return state_space(*(matrices[name] for name in "ABCD"), name=file.stem)


def answer(
    archive: Path,
    system: "System",
    search: Callable[..., "Bounds"],
    asked: dict[str, Any],
    *,
    store: bool,
    as_json: bool,
) -> "Bounds":
    """Search, and say how far it is; store and print what is found."""
    start = time.perf_counter()
    with progress_of(system.name) as progress:
        found = search(system, **asked, progress=progress.bounds)
    _report(archive, system, found, time.perf_counter() - start, store=store, as_json=as_json)
    return found


def _report(
    archive: Path, system: "System", found: "Bounds", seconds: float, *, store: bool, as_json: bool
) -> None:
    """Store a result, and print it."""
    if store:
        from mbdlft.archive.analysis import save_analysis

        save_analysis(archive, system, found)
    if as_json:
        print_json(_as_json(found, seconds))
        return
    out = console()
    out.print(f"{system.name}, {found.kind}:", highlight=False)
    out.print(_said(found), highlight=False)
    if found.motion is not None:
        out.print(
            f"not stable at a motion of {found.upper:.6g} times the ranges, of the period "
            f"{2.0 * math.pi / found.frequency:.6g} s",
            highlight=False,
        )
    if found.worst:
        units = {p.name: p.unit for p in system.parameters}
        reached = found.lower if _is_largest(found) else found.upper
        near = f" at {found.frequency:.6g} rad/s" if math.isfinite(found.frequency) else ""
        title = f"worst case: {reached:.6g}{near}"
        rows = table(title, "parameter", "value >", "unit", "delta >", "share >")
        for name, value in found.worst.items():
            delta = found.delta.get(name, 0.0)
            share = found.sensitivity.get(name, 0.0)
            rows.add_row(name, f"{value:.6g}", units[name], f"{delta:.4f}", f"{share:.3f}")
        out.print(rows)
    if found.reason:
        out.print(f"why not more: {found.reason}", soft_wrap=True, highlight=False)


def _is_largest(found: "Bounds") -> bool:
    """Whether what is large is bad: its lower bound is reached, and its upper one proved."""
    return not found.kind.startswith(("robust", "smallest"))


def _said(found: "Bounds") -> str:
    """What is proved, as a sentence."""
    moving = ", ".join(f"{name} {rate:g}" for name, rate in found.rates.items())
    how = f"for rates up to {moving} per second" if moving else "for all frequencies"
    if not found.proved:
        return "nothing is proved"
    if found.kind == "robust stability":
        others = f", {', '.join(found.fixed)} in theirs" if found.fixed else ""
        return f"stable for all values in {found.lower:.6g} times the ranges{others}: proved {how}"
    if found.kind == "smallest damping":
        return f"at least {found.lower:.6g} for all values in the ranges: proved"
    bound = f"at most {found.upper:.6g}" if _is_largest(found) else f"at least {found.lower:.6g}"
    unit = " rad/s" if found.kind == "largest real part" else ""
    return f"{bound}{unit} for all values in the ranges: proved {how}"


def _as_json(found: "Bounds", seconds: float) -> dict[str, Any]:
    return {
        "kind": found.kind,
        "lower": number(found.lower),
        "upper": number(found.upper),
        "frequency": number(found.frequency),
        "worst": dict(found.worst),
        "fixed": list(found.fixed),
        "rates": {name: number(rate) for name, rate in found.rates.items()},
        "proved": found.proved,
        "sensitivity": dict(found.sensitivity),
        "work": found.work,
        "reason": found.reason,
        "seconds": seconds,
    }


def number(value: float) -> float | None:
    """A number that JSON has; None for inf and NaN."""
    return value if math.isfinite(value) else None
