"""The commands `margin`, `wcgain`, `worst`, `verify`, `tune`: guarantees, and controllers."""

import math
import time
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from mbdlft import analyze, multibody, show, synthesis
from mbdlft import archive as archives
from mbdlft import system as systems
from mbdlft.base.errors import AnalysisError, StructureError
from mbdlft.cli import options, rooms
from mbdlft.cli.output import print_json, print_table, progress_of, say, write_scene
from mbdlft.cli.responses import WITH_WORST, chosen_channels, draw

_EDGE = 1e-3  # of the ranges: a smaller margin is said to be none
_WITH = " with "  # in the name of a loop
_PRINTED = (
    *("kind", "lower", "upper", "frequency", "worst", "inputs", "outputs", "fixed", "rates"),
    *("sensitivity", "work", "reason"),
)
_RATE = "NAME=BOUND, such as mass=0.1 or mass=inf."


class Property(StrEnum):
    """What `worst` looks for."""

    REAL_PART = "real-part"
    DAMPING = "damping"
    DISK_MARGIN = "disk-margin"
    H2_NORM = "h2-norm"


def margin(
    archive: options.Archive,
    controller: options.Controller = None,
    model: options.Model = None,
    gap: options.Gap = 0.01,
    work: options.Work = 30.0,
    rate: options.Rate = None,
    fixed: Annotated[
        options.Texts,
        typer.Option("--fixed", help="Parameter or block that stays in its range; may be repeated."),
    ] = None,
    leave_out: options.LeaveOut = None,
    workers: options.Workers = 1,
    figure: options.Plot = None,
    width: options.FigureWidth = None,
    no_save: options.NoSave = False,
    as_json: options.AsJson = False,
) -> None:
    """Bounds of the margin of robust stability, proved for all frequencies and values."""
    options.check_paths(None, figure)
    system, ignored = _loop(archive, model, controller), leave_out or ()
    asked: dict[str, Any] = {"gap": gap, "work": work, "leave_out": ignored, "workers": workers}
    asked |= {"rates": options.numbers_by_name("--rate", rate, _RATE), "fixed": fixed or ()}
    bounds, _ = _answer(
        archive, system, analyze.robust_stability, asked, store=not no_save, as_json=as_json
    )
    if figure is not None:
        with options.on_paper(width):
            show.save_mu(figure, system, bounds, leave_out=ignored)


def wcgain(
    archive: options.Archive,
    inputs: options.Inputs = None,
    outputs: options.Outputs = None,
    controller: options.Controller = None,
    model: options.Model = None,
    gap: options.Gap = 0.01,
    work: options.Work = 30.0,
    rate: options.Rate = None,
    leave_out: options.LeaveOut = None,
    workers: options.Workers = 1,
    figure: options.Plot = None,
    kind: Annotated[
        str,
        typer.Option(help="Of the figure with the worst case: sigma, bode, nyquist, nichols or step."),
    ] = "sigma",
    width: options.FigureWidth = None,
    no_save: options.NoSave = False,
    as_json: options.AsJson = False,
) -> None:
    """Bounds of the largest gain over the declared ranges, proved for all frequencies and values."""
    options.check_paths(None, figure)
    if kind not in WITH_WORST:
        raise AnalysisError(f"--kind {kind}: expected one of {', '.join(WITH_WORST)}.")
    system = _loop(archive, model, controller)
    asked = _asked(gap, work, leave_out, workers, inputs, outputs)
    asked |= {"rates": options.numbers_by_name("--rate", rate, _RATE)}
    answer = _answer(archive, system, analyze.worst_case_gain, asked, store=not no_save, as_json=as_json)
    if figure is not None:
        bounds, is_proved = answer
        more: dict[str, Any] = {"bound": bounds.upper} if kind == "sigma" and is_proved else {}
        with options.on_paper(width):
            shown = chosen_channels(system, outputs, inputs)
            draw(kind, figure, shown, worst=bounds.worst or None, **more)


def worst(
    archive: options.Archive,
    what: Annotated[Property, typer.Option("--of", help="What is to be bad.")],
    inputs: options.Inputs = None,
    outputs: options.Outputs = None,
    controller: options.Controller = None,
    model: options.Model = None,
    gap: options.Gap = 0.01,
    work: options.Work = 30.0,
    leave_out: options.LeaveOut = None,
    workers: options.Workers = 1,
    no_save: options.NoSave = False,
    as_json: options.AsJson = False,
) -> None:
    """The worst real part, damping, disk margin or H2 norm over the ranges, with proved bounds."""
    system = _loop(archive, model, controller)
    asked = _asked(gap, work, leave_out, workers, inputs, outputs)
    asked |= {"what": "H2 norm" if what == Property.H2_NORM else what.replace("-", " ")}
    _answer(archive, system, analyze.worst_case, asked, store=not no_save, as_json=as_json)


def verify(archive: options.Archive, as_json: options.AsJson = False) -> None:
    """Check every stored proof again, without a search."""
    names = archives.analysis_names(archive)
    if not names:
        raise AnalysisError(f"{archive}: there is no analysis to be checked. `mbdlft margin` makes one.")
    checked: list[dict[str, Any]] = []
    with progress_of(archive.stem) as progress:
        for count, name in enumerate(names):
            progress.counted(count, len(names))
            system, bounds = archives.load_analysis(archive, name)
            start = time.perf_counter()
            wrong = analyze.verify(system, bounds)
            entry = {
                "name": name,
                "claim": str(bounds.claim),
                "lower": bounds.lower,
                "upper": bounds.upper,
            }
            entry |= {"proved": not wrong, "reason": wrong, "seconds": time.perf_counter() - start}
            checked.append(entry)
    if as_json:
        print_json(checked)
    else:
        for entry in checked:
            verdict = f"{entry['claim']}: proved" if entry["proved"] else f"NOT PROVED: {entry['reason']}"
            say(f"{entry['name']}: {verdict}")
    if not all(entry["proved"] for entry in checked):
        raise typer.Exit(1)


def _asked(
    gap: float, work: float, leave_out: Any, workers: int, inputs: Any, outputs: Any
) -> dict[str, Any]:
    """What is asked of the transfer from inputs to outputs, or from all to all."""
    asked = {"gap": gap, "work": work, "leave_out": leave_out or (), "workers": workers}
    return {**asked, "inputs": inputs or slice(None), "outputs": outputs or slice(None)}


def _loop(archive: Path, model: str | None, controller: Path | None) -> "systems.System":
    """The model of an archive, closed through a controller if there is one."""
    names = archives.model_names(archive)
    if model is None:  # loops that were stored beside a model are not meant
        alone = [name for name in names if _WITH not in name]
        model = alone[0] if len(alone) == 1 else None
    system = options.stored_system(archive, model)
    if controller is None:
        return system
    loop = systems.feedback(system, _controller(controller))
    name = f"{system.name}{_WITH}{controller.stem}"
    if name in names:
        stored = options.stored_system(archive, name)
        if _same(stored, loop):
            return stored
    return systems.as_system(loop, name=name)


def _same(a: "systems.System", b: "systems.System") -> bool:
    """Whether two systems have the same numbers and names."""
    same = all(np.array_equal(getattr(a.lft, M), getattr(b.lft, M)) for M in ("M11", "M12", "M21", "M22"))
    return same and a.parameters == b.parameters and a.inputs == b.inputs and a.outputs == b.outputs


def _controller(file: Path) -> Any:
    """A controller of an archive, or of the matrices A, B, C, D of a .mat file."""
    if file.suffix.lower() != ".mat":
        return options.stored_system(file, None)
    from scipy.io import loadmat  # here because it is slow to import

    try:
        matrices = loadmat(file)
    except Exception as error:  # what scipy raises for damaged files has no common class
        raise AnalysisError(f"{file}: no .mat file that can be read: {error}.") from None
    missing = [name for name in "ABCD" if name not in matrices]
    if missing:
        raise AnalysisError(
            f"{file}: expected the matrices A, B, C, D of a controller; {', '.join(missing)} missing."
        )
    full = (m.toarray() if hasattr(m, "toarray") else m for m in map(matrices.get, "ABCD"))
    found = [np.asarray(matrix) for matrix in full]
    if any(matrix.dtype.kind not in "biuf" for matrix in found):
        raise AnalysisError(f"{file}: expected matrices A, B, C, D of real numbers.")
    return systems.state_space(*found, name=file.stem)


def _answer(
    archive: Path,
    system: "systems.System",
    search: Callable[..., "analyze.Bounds"],
    asked: dict[str, Any],
    *,
    store: bool,
    as_json: bool,
) -> tuple["analyze.Bounds", bool]:
    """Search, and say how far it is; store and print the bounds. Also whether their claim is proved."""
    start = time.perf_counter()
    with progress_of(system.name) as progress:
        bounds = search(system, **asked, progress=progress.bounds)
        wrong = analyze.verify(system, bounds)
    seconds = time.perf_counter() - start
    if store:
        archives.save_analysis(archive, system, bounds)
    if as_json:
        values = {name: getattr(bounds, name) for name in _PRINTED}
        print_json({**values, "proved": not wrong, "seconds": seconds})
    else:
        _print(system, bounds, wrong)
    return bounds, not wrong


def _print(system: "systems.System", bounds: "analyze.Bounds", wrong: str) -> None:
    """What is proved, the worst case, and why not more is proved."""
    is_empty = wrong or bounds.proof is None  # such as that no damping is below -1
    say(f"{system.name}, {bounds.kind}:", "nothing is proved" if is_empty else f"{bounds.claim}: proved")
    if bounds.kind == "robust stability" and bounds.upper < _EDGE:
        say(
            f"nominal is on the edge of stability: {bounds.upper:.2g} of the ranges brings a pole to the "
            f"axis at {bounds.frequency:.6g} rad/s"
        )
    if wrong and bounds.proof is not None:
        say(f"its proof is none: {wrong}")
    if bounds.motion is not None:
        say(
            f"not stable at a motion of {bounds.upper:.6g} times the ranges, of the period "
            f"{2.0 * math.pi / bounds.frequency:.6g} s"
        )
    if bounds.worst:
        near = f" at {bounds.frequency:.6g} rad/s" if math.isfinite(bounds.frequency) else ""
        title = f"worst case: {bounds.reached:.6g}{near}"
        rows = rooms.content.worst_rows(system, bounds)
        print_table(title, "parameter | value > | unit | delta > | share >", rows)
    if bounds.reason:
        say(f"why not more: {bounds.reason}")


def tune(
    file: Annotated[Path, typer.Argument(help="Task (TOML): model, connections, controllers, goals.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Archive for controllers, loops and proofs.")
    ] = None,
    scene: Annotated[
        Path | None,
        typer.Option(
            "--scene", help="Scene (TOML) to be written, with design parameters as they were tuned."
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot", help="Figure to be written: goals, steps, poles, gains over the schedule."
        ),
    ] = None,
    starts: Annotated[int, typer.Option(min=1, help="Places from which the search begins.")] = 8,
    seed: Annotated[int, typer.Option(help="Which places these are.")] = 0,
    no_proof: Annotated[bool, typer.Option("--no-proof", help="Leave the proofs out.")] = False,
    gap: options.Gap = 0.01,
    work: options.Work = 30.0,
    workers: options.Workers = 1,
    as_json: options.AsJson = False,
) -> None:
    """Tune controllers for goals at the worst values of the parameters, and prove the result."""
    options.check_paths(output, plot, beside=(file, scene))
    start = time.perf_counter()
    task = synthesis.load_tuning(file)
    model = options.load_system(file.parent / task.model)
    designed = None if scene is None else multibody.load_scene(file.parent / task.model)
    if designed is not None and not any(p.role == "design" for p in designed.parameters):
        raise StructureError(f"--scene: {task.model} has no parameter of the role 'design'.")
    how: dict[str, Any] = {"starts": starts, "seed": seed, "gap": gap, "work": work, "workers": workers}
    with progress_of(file.stem) as progress:
        tuning = synthesis.tune_task(task, model, **how, prove=not no_proof, progress=progress.stage)
    if output is not None:
        synthesis.save_tuning(output, tuning)
    if plot is not None:
        show.save_tuning_figure(plot, tuning)
    if scene is not None and designed is not None:
        write_scene(scene, synthesis.designed_scene(designed, tuning.values))
    is_reached = all(reached.is_reached for reached in tuning.goals)
    if as_json:
        print_json(
            {
                "values": tuning.values,
                "goals": [_entry(reached) for reached in tuning.goals],
                "points": list(tuning.points),
                "reached": is_reached,
                "missing": tuning.missing,
                "seconds": time.perf_counter() - start,
            }
        )
    else:
        _print_tuning(tuning, output)
        if scene is not None:
            say(f"scene with the new design: {scene}")
    if tuning.missing:
        raise typer.Exit(3 if is_reached else 1)


def _print_tuning(tuning: "synthesis.Tuning", output: Path | None) -> None:
    """Values, goals, and why a proof is open."""
    rows = ((name, f"{value:.6g}") for name, value in tuning.values.items())
    print_table("values", "value | number >", rows)
    entries = [_entry(reached) for reached in tuning.goals]
    goals = (
        (g["name"], "hard" if g["hard"] else "soft", *(_number(g[key]) for key in _COLUMNS))
        for g in entries
    )
    headings = " > | ".join(_COLUMNS.values())
    print_table("goals, reached at 1", f"goal | kind | {headings} >", goals)
    for reached in tuning.goals:
        say(*(f"{reached.goal.name}: {b.reason}" for b in reached.bounds if b.reason))
    if output is not None:
        say(f"controllers, loops and proofs: {output}")
    say(*tuning.missing)


_COLUMNS = {"tuned": "tuned", "worst": "worst found", "proved": "proved", "least": "no controller below"}


def _entry(reached: "synthesis.Reached") -> dict[str, Any]:
    numbers = {key: getattr(reached, key) for key in _COLUMNS}
    return {"name": reached.goal.name, "kind": reached.goal.kind, "hard": reached.goal.hard, **numbers}


def _number(value: float) -> str:
    return f"{value:.4g}" if 0.0 < value < math.inf else "-"
