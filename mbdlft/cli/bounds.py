"""The commands `margin`, `wcgain`, `worst`, `verify`: guarantees for a model, and their proofs."""

import math
import time
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mbdlft.base.errors import AnalysisError
from mbdlft.cli.options import (
    Archive,
    AsJson,
    Controller,
    Gap,
    Inputs,
    LeaveOut,
    Model,
    NoSave,
    Outputs,
    Plot,
    Rate,
    Work,
    Workers,
)
from mbdlft.cli.output import console, print_json, progress_of, table
from mbdlft.cli.responses import chosen_channels
from mbdlft.cli.sources import stored_system

if TYPE_CHECKING:
    from mbdlft.robust.evidence import Bounds
    from mbdlft.system.model import System


class Property(StrEnum):
    """What `worst` looks for."""

    REAL_PART = "real-part"
    DAMPING = "damping"
    DISK_MARGIN = "disk-margin"
    H2_NORM = "h2-norm"


def margin(
    archive: Archive,
    controller: Controller = None,
    model: Model = None,
    gap: Gap = 0.01,
    work: Work = 30.0,
    rate: Rate = None,
    fixed: Annotated[
        list[str] | None,
        typer.Option(
            "--fixed", help="Parameter or block that stays in its range; may be repeated."
        ),
    ] = None,
    leave_out: LeaveOut = None,
    workers: Workers = 1,
    figure: Plot = None,
    no_save: NoSave = False,
    as_json: AsJson = False,
) -> None:
    """Bounds of the margin of robust stability, proved for all frequencies and values."""
    from mbdlft.robust.stability import robust_stability

    _check(figure)
    system = loop_of(archive, model, controller)
    asked = {"gap": gap, "work": work, "rates": _rates(rate), "leave_out": leave_out or ()}
    asked |= {"workers": workers, "fixed": fixed or ()}
    found = answer(archive, system, robust_stability, asked, store=not no_save, as_json=as_json)
    if figure is not None:
        from mbdlft.show.figures.pole_maps import save_mu

        save_mu(figure, system, found, leave_out=leave_out or ())


def wcgain(
    archive: Archive,
    inputs: Inputs = None,
    outputs: Outputs = None,
    controller: Controller = None,
    model: Model = None,
    gap: Gap = 0.01,
    work: Work = 30.0,
    rate: Rate = None,
    leave_out: LeaveOut = None,
    workers: Workers = 1,
    figure: Plot = None,
    no_save: NoSave = False,
    as_json: AsJson = False,
) -> None:
    """Bounds of the largest gain over the declared ranges, proved for all frequencies and values."""
    from mbdlft.robust.gain import worst_case_gain

    _check(figure)
    system = loop_of(archive, model, controller)
    channels = {"inputs": inputs or slice(None), "outputs": outputs or slice(None)}
    asked = {"gap": gap, "work": work, "rates": _rates(rate), "leave_out": leave_out or ()}
    asked |= {"workers": workers}
    found = answer(
        archive, system, worst_case_gain, channels | asked, store=not no_save, as_json=as_json
    )
    if figure is not None:
        from mbdlft.show.figures.responses import save_singular_values

        bound = found.upper if found.proved else None
        shown = chosen_channels(system, outputs, inputs)
        save_singular_values(figure, shown, worst=found.worst or None, bound=bound)


def worst(
    archive: Archive,
    what: Annotated[Property, typer.Option("--of", help="What is to be bad.")],
    inputs: Inputs = None,
    outputs: Outputs = None,
    controller: Controller = None,
    model: Model = None,
    gap: Gap = 0.01,
    work: Work = 30.0,
    leave_out: LeaveOut = None,
    workers: Workers = 1,
    no_save: NoSave = False,
    as_json: AsJson = False,
) -> None:
    """The worst real part, damping, disk margin or H2 norm over the ranges, with proved bounds."""
    from mbdlft.robust.worst import worst_case

    system = loop_of(archive, model, controller)
    property_of = {"h2-norm": "H2 norm"}.get(what, what.replace("-", " "))
    asked: dict[str, Any] = {
        "what": property_of,
        "inputs": inputs or slice(None),
        "outputs": outputs or slice(None),
    }
    asked |= {"gap": gap, "work": work, "leave_out": leave_out or (), "workers": workers}
    answer(archive, system, worst_case, asked, store=not no_save, as_json=as_json)


def verify(archive: Archive, as_json: AsJson = False) -> None:
    """Check every stored proof again, without a search."""
    from mbdlft.archive.analysis import analysis_names, load_analysis
    from mbdlft.robust.proofs import verify as check

    names = analysis_names(archive)
    if not names:
        raise AnalysisError(
            f"{archive}: there is no analysis to be checked. `mbdlft margin` makes one."
        )
    found = []
    with progress_of(archive.stem) as progress:
        for count, name in enumerate(names):
            progress.counted(count, len(names))
            system, bounds = load_analysis(archive, name)
            start = time.perf_counter()
            wrong = check(system, bounds)
            seconds = time.perf_counter() - start
            found.append(
                {
                    "name": name,
                    "lower": number(bounds.lower),
                    "upper": number(bounds.upper),
                    "proved": not wrong,
                    "reason": wrong,
                    "seconds": seconds,
                }
            )
    if as_json:
        print_json(found)
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


def _check(figure: Path | None) -> None:
    """Raise an error if it is known before the work that a figure cannot be written."""
    if figure is not None:
        from mbdlft.show.figures.figures import check_figure

        check_figure(figure)


_WITH = " with "  # in the name of a loop


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
