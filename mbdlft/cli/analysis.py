"""The commands `margin`, `wcgain`, `verify`: guarantees for a model of an archive, and their proofs."""

import json
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from mbdlft.base.errors import AnalysisError
from mbdlft.cli.response import chosen_channels
from mbdlft.cli.tables import console, table

if TYPE_CHECKING:
    from mbdlft.bound.evidence import Bounds
    from mbdlft.system.system import System

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
NoSave = Annotated[bool, typer.Option("--no-save", help="Do not store the result.")]


def margin(
    archive: Archive,
    controller: Controller = None,
    model: Model = None,
    gap: Gap = 0.01,
    work: Work = 30.0,
    rate: Rate = None,
    leave_out: LeaveOut = None,
    figure: Plot = None,
    no_save: NoSave = False,
    as_json: AsJson = False,
) -> None:
    """Bounds of the margin of robust stability, proved for all frequencies and values."""
    from mbdlft.analyze.margin import robust_stability

    _check(figure)
    system = _loop(archive, model, controller)
    asked = {"gap": gap, "work": work, "rates": _rates(rate), "leave_out": leave_out or ()}
    found = _answer(archive, system, robust_stability, asked, store=not no_save, as_json=as_json)
    if figure is not None:
        from mbdlft.plot import save_mu

        save_mu(figure, system, found, leave_out=leave_out or ())


def wcgain(
    archive: Archive,
    inputs: Annotated[
        list[str] | None, typer.Option("--input", help="Input; all by default; may be repeated.")
    ] = None,
    outputs: Annotated[
        list[str] | None, typer.Option("--output", help="Output; all by default; may be repeated.")
    ] = None,
    controller: Controller = None,
    model: Model = None,
    gap: Gap = 0.01,
    work: Work = 30.0,
    rate: Rate = None,
    leave_out: LeaveOut = None,
    figure: Plot = None,
    no_save: NoSave = False,
    as_json: AsJson = False,
) -> None:
    """Bounds of the largest gain over the declared ranges, proved for all frequencies and values."""
    from mbdlft.analyze.gain import worst_case_gain

    _check(figure)
    system = _loop(archive, model, controller)
    channels = {"inputs": inputs or slice(None), "outputs": outputs or slice(None)}
    asked = {"gap": gap, "work": work, "rates": _rates(rate), "leave_out": leave_out or ()}
    found = _answer(
        archive, system, worst_case_gain, channels | asked, store=not no_save, as_json=as_json
    )
    if figure is not None:
        from mbdlft.plot import save_singular_values

        bound = found.upper if found.proved else None
        shown = chosen_channels(system, outputs, inputs)
        save_singular_values(figure, shown, worst=found.worst or None, bound=bound)


def verify(archive: Archive, as_json: AsJson = False) -> None:
    """Check every stored proof again, without a search."""
    from mbdlft.analyze.recheck import verify as check
    from mbdlft.store import analysis_names, load_analysis

    names = analysis_names(archive)
    if not names:
        raise AnalysisError(
            f"{archive}: there is no analysis to be checked. `mbdlft margin` makes one."
        )
    found = []
    for name in names:
        system, bounds = load_analysis(archive, name)
        start = time.perf_counter()
        wrong = check(system, bounds)
        seconds = time.perf_counter() - start
        found.append(
            {
                "name": name,
                "lower": _number(bounds.lower),
                "upper": _number(bounds.upper),
                "proved": not wrong,
                "reason": wrong,
                "seconds": seconds,
            }
        )
    if as_json:
        sys.stdout.write(json.dumps(found, indent=2) + "\n")
    else:
        for entry in found:
            said = "proved" if entry["proved"] else f"NOT PROVED: {entry['reason']}"
            console().print(f"{entry['name']}: {said}", soft_wrap=True, highlight=False)
    if not all(entry["proved"] for entry in found):
        raise typer.Exit(1)


def _rates(texts: list[str] | None) -> dict[str, float]:
    """Bounds of rates by name, of texts NAME=BOUND."""
    found = {}
    for text in texts or ():
        name, _, bound = text.partition("=")
        try:
            found[name.strip()] = float(bound)
        except ValueError:
            raise AnalysisError(
                f"--rate {text}: expected NAME=BOUND, such as mass=0.1 or mass=inf."
            ) from None
    return found


def _loop(archive: Path, model: str | None, controller: Path | None) -> "System":
    """The model of an archive, closed through a controller if there is one."""
    from mbdlft.store import load, model_names
    from mbdlft.system import as_system, feedback

    names = model_names(archive)
    if model is None:  # loops that were stored beside a model are not meant
        alone = [name for name in names if _WITH not in name]
        model = alone[0] if len(alone) == 1 else None
    system: System = load(archive, model)
    if controller is None:
        return system
    loop = feedback(system, _controller(controller))
    name = f"{system.name}{_WITH}{controller.stem}"
    if name in names:
        stored: System = load(archive, name)
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
        from mbdlft.store import load

        return load(file)
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


def _answer(
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
    with Console(stderr=True).status("") as status:

        def told(low: float, high: float) -> None:
            status.update(f"{low:.4g} to {high:.4g}")

        found = search(system, **asked, progress=told)
    _report(archive, system, found, time.perf_counter() - start, store=store, as_json=as_json)
    return found


def _check(figure: Path | None) -> None:
    """Raise an error if it is known before the work that a figure cannot be written."""
    if figure is not None:
        from mbdlft.plot import check_figure

        check_figure(figure)


def _report(
    archive: Path, system: "System", found: "Bounds", seconds: float, *, store: bool, as_json: bool
) -> None:
    """Store a result, and print it."""
    if store:
        from mbdlft.store import save_analysis

        save_analysis(archive, system, found)
    if as_json:
        sys.stdout.write(json.dumps(_as_json(found, seconds), indent=2) + "\n")
        return
    out = console()
    out.print(f"{system.name}, {found.kind}:", highlight=False)
    is_gain = found.kind == "worst-case gain"
    moving = ", ".join(f"{name} {rate:g}" for name, rate in found.rates.items())
    how = f"for rates up to {moving} per second" if moving else "for all frequencies"
    if not found.proved:
        said = "nothing is proved"
    elif is_gain:
        said = f"at most {found.upper:.6g} for all values in the ranges: proved {how}"
    else:
        said = f"stable for all values in {found.lower:.6g} times the ranges: proved {how}"
    out.print(said, highlight=False)
    if found.motion is not None:
        out.print(
            f"not stable at a motion of {found.upper:.6g} times the ranges, of the period "
            f"{2.0 * math.pi / found.frequency:.6g} s",
            highlight=False,
        )
    if found.worst:
        units = {p.name: p.unit for p in system.parameters}
        reached = found.lower if is_gain else found.upper
        title = f"worst case: {reached:.6g} at {found.frequency:.6g} rad/s"
        rows = table(title, "parameter", "value >", "unit", "delta >", "share >")
        for name, value in found.worst.items():
            delta = found.delta.get(name, 0.0)
            share = found.sensitivity.get(name, 0.0)
            rows.add_row(name, f"{value:.6g}", units[name], f"{delta:.4f}", f"{share:.3f}")
        out.print(rows)
    if found.reason:
        out.print(f"why not more: {found.reason}", soft_wrap=True, highlight=False)


def _as_json(found: "Bounds", seconds: float) -> dict[str, Any]:
    return {
        "kind": found.kind,
        "lower": _number(found.lower),
        "upper": _number(found.upper),
        "frequency": _number(found.frequency),
        "worst": dict(found.worst),
        "rates": {name: _number(rate) for name, rate in found.rates.items()},
        "proved": found.proved,
        "sensitivity": dict(found.sensitivity),
        "work": found.work,
        "reason": found.reason,
        "seconds": seconds,
    }


def _number(value: float) -> float | None:
    """A number that JSON has; None for inf and NaN."""
    return value if math.isfinite(value) else None
