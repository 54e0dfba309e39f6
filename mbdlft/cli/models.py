"""The commands `check`, `linearize`, `realize`, `show`: models of scenes, robots, matrices, archives."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from mbdlft import analyze, base, batch, matrix, modelica, multibody, problem
from mbdlft import archive as archives
from mbdlft import system as systems
from mbdlft.base.errors import AnalysisError, MbdlftError
from mbdlft.cli import options, rooms
from mbdlft.cli.output import (
    console,
    parameters_data,
    print_json,
    print_parameters,
    print_table,
    progress_of,
    say,
    signals_data,
)
from mbdlft.cli.responses import KINDS, OVER, draw, modes_data, print_poles
from mbdlft.cli.scenes import efforts_data, print_efforts, shortened_list


def report_model(
    model: "systems.LFTModel",
    seconds: Mapping[str, float],
    paths: Mapping[str, Path | None],
    notes: Sequence[str],
    *,
    as_json: bool,
) -> None:
    """Print a model that was made, with `notes`, the `seconds` of each stage and the written files."""
    seconds = {**seconds, "total": sum(seconds.values())}
    if as_json:
        print_json({**_model_data(model), "seconds": seconds, "notes": list(notes)})
        return
    print_model(model)
    say(*notes)
    say("seconds: " + ", ".join(f"{name} {value:.3f}" for name, value in seconds.items()))
    say(*(f"{what}: {path}" for what, path in paths.items() if path is not None))


def show(
    archive: options.Archive,
    name: Annotated[str | None, typer.Option(help="Only the model of this name.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Print what is in an archive, and from when."""
    names = [name] if name else archives.model_names(archive)
    models = [archives.load(archive, key) for key in names]
    sweeps: list[str] = []
    analyses: list[dict[str, Any]] = []
    if name is None:
        sweeps = list(archives.sweep_names(archive))
        for key in archives.analysis_names(archive):
            _, bounds = archives.load_analysis(archive, key)
            ends = {"lower": bounds.lower, "upper": bounds.upper}
            analyses.append({"name": key, "kind": bounds.kind, **ends})
    if as_json:
        beside = {} if name else {"sweeps": sweeps, "analyses": analyses}
        print_json({"models": [_stored_data(model) for model in models], **beside})
        return
    for model in models:
        _print_stored(model)
    if sweeps:
        say(f"sweeps: {', '.join(sweeps)}")
    for entry in analyses:
        lower, upper = (
            f"{entry[end]:.6g}" if math.isfinite(entry[end]) else "unbounded"
            for end in ("lower", "upper")
        )
        say(f"analysis {entry['name']}: {entry['kind']} {lower} to {upper}")


def _print_stored(model: "systems.System | systems.DeltaThetaModel") -> None:
    """Print a model, its nonlinear functions, and from when it is."""
    linear = model if isinstance(model, systems.System) else model.linear
    print_model(linear)
    say(*(f"nonlinear: {function}" for function in getattr(model, "functions", ())))
    if isinstance(linear, systems.LFTModel):
        made = linear.provenance
        say(f"made {made.created} by mbdlft {made.mbdlft}, CasADi {made.casadi}")
        if linear.known_program is not None:
            say(f"stored program: {linear.known_program.length} instructions")


def print_model(model: "systems.System") -> None:
    """Print the signals, parameters and poles of a model, and what its certificate says."""
    console().print(f"{model.name}  {model.description}", style="bold", highlight=False)
    for what in ("states", "inputs", "outputs"):
        signals = getattr(model, what)
        listed = ", ".join(f"{signal.name} ({signal.unit})" for signal in signals)
        console().print(f"{what} ({len(signals)}): {listed}".rstrip(": "), highlight=False)
    if isinstance(model, systems.LFTModel):
        _print_repetitions(model)
        say(*rooms.sentences.certificate_sentences(model))
        if model.trim.signals:
            pairs = list(zip(model.trim.signals, model.trim.nominal, strict=True))
            nonzero = [f"{s.name} = {value:.6g} {s.unit}" for s, value in pairs if value]
            zero = [s.name for s, value in pairs if not value]
            nonzero += [f"zero: {shortened_list(zero)}"] if zero else []
            say(f"trim at nominal: {', '.join(nonzero)}")
    else:
        blocks = ", ".join(f"{b.name} ({b.kind}, {b.outputs} x {b.inputs})" for b in model.lft.blocks)
        say(f"order {model.order}: {blocks or 'no blocks'}; stored without evidence")
    print_poles(model)


def _print_repetitions(model: "systems.LFTModel") -> None:
    """Print a row for each parameter: its range and its repetitions, with their sums below."""
    certificate = model.certificate
    counts = (certificate.order, certificate.lower_bound, certificate.raw_order)
    rows = (
        (p.name, p.unit, f"{p.nominal:g}", f"[{p.low:g}, {p.high:g}]", p.role, *map(str, repetitions))
        for p, *repetitions in zip(model.parameters, *counts, strict=True)
    )
    headings = "parameter | unit | nominal > | range > | role | repetitions > | lower bound > | before"
    sums = ("total", "", "", "", "", *(str(sum(count)) for count in counts))
    print_table(None, f"{headings} reduction >", rows, sums)


def _stored_data(model: "systems.System | systems.DeltaThetaModel") -> dict[str, Any]:
    """A stored model as plain data: that of its linear part if it has nonlinear functions."""
    if not isinstance(model, systems.System):
        return {**_stored_data(model.linear), "functions": [str(f) for f in model.functions]}
    if isinstance(model, systems.LFTModel):
        made = {key: getattr(model.provenance, key) for key in ("created", "mbdlft", "casadi")}
        return {**_model_data(model), **made}
    return {"name": model.name, **signals_data(model), "order": model.order}


def _model_data(model: "systems.LFTModel") -> dict[str, Any]:
    """A model and its certificate as plain data."""
    c = model.certificate
    parameters = parameters_data(model.parameters)
    for k, entry in enumerate(parameters):
        for name in ("order", "lower_bound", "gap", "raw_order"):
            entry[name] = getattr(c, name)[k]
        entry["doubtful"] = c.doubtful[k] if c.doubtful else None
    trim = [
        {"name": signal.name, "unit": signal.unit, "nominal": value}
        for signal, value in zip(model.trim.signals, model.trim.nominal, strict=True)
    ]
    as_they_are = (
        *("order_bound", "minimal", "exact_bound", "exact", "truncation_error", "fit_error_bound"),
        *("max_relative_error", "check_points", "well_posed"),
    )
    return {
        "name": model.name,
        **signals_data(model),
        "parameters": parameters,
        "trim": trim,
        **{name: sum(getattr(c, name)) for name in ("order", "lower_bound", "raw_order")},
        **{name: getattr(c, name) for name in as_they_are},
        "transfer_error": c.transfer_error if c.frequencies else None,
        "frequencies": list(c.frequencies),
        "near": list(c.near),
        "by_terms": [list(entry) for entry in c.by_terms],
        "condition": c.condition or None,
        "sign_changes": c.sign_changes if c.condition else None,
        "rounding_ratio": c.rounding_ratio if c.condition or c.rounding_ratio else None,
        "open_boxes": [[list(ends) for ends in box] for box in c.open_boxes],
        **modes_data(analyze.damping_table(model)),
    }


ModelFile = Annotated[
    Path,
    typer.Argument(
        metavar="FILE",
        help="Scene (TOML), robot (.urdf, .sdf, .xml, .xacro), or Modelica model (.mo, .mof).",
    ),
]
TableFile = Annotated[
    Path | None,
    typer.Option("--parameters", help="Which parameters of a Modelica model stay: a TOML file."),
]
ModelName = Annotated[
    str | None, typer.Option("--model", help="Which model of a .mo or .sdf file with several.")
]


def check(
    file: ModelFile,
    table_file: TableFile = None,
    model_name: ModelName = None,
    vary: options.Vary = None,
    at: options.Point = None,
    as_json: options.AsJson = False,
) -> None:
    """Check a scene, a robot or a Modelica model, and trim it at nominal."""
    if options.is_modelica(file):
        _check_modelica(file, table_file, model_name, vary, at, as_json=as_json)
        return
    _refuse_options(file, table_file, model_name, vary, at)
    scene = options.scene_in(file, model_name)
    both = rooms.assembly.assembly(scene)
    equations = both.equations
    inputs, outputs = rooms.to_problem.choose_signals(scene, equations)
    counts = {"bodies": len(scene.bodies), "joints": len(scene.joints)}
    point = problem.solve_trim(equations)
    notes = _notes(scene, point.signals, point.values)
    if reason := rooms.to_problem.too_large(scene):  # its slopes would take as long
        notes.append(f"It is too large to be linearized: {reason}")
    else:
        counts["states"] = len(rooms.to_problem.choose_states(scene, both.exact, inputs, outputs).states)
        rooms.linearization.relinearize(
            equations, inputs, outputs, np.array([[p.nominal for p in equations.parameters]])
        )
    parameters = equations.parameters
    if as_json:
        data = {"parameters": parameters_data(parameters), "efforts": efforts_data(point)}
        print_json({"name": scene.name, **counts, **data, "notes": notes})
        return
    counts["parameters"] = len(scene.parameters)
    say(f"{scene.name}: {', '.join(f'{count} {what}' for what, count in counts.items())}.")
    print_parameters(parameters)
    print_efforts(point)
    say(*notes, "The scene is usable.")


def _check_modelica(
    file: Path,
    table_file: Path | None,
    name: str | None,
    vary: list[str] | None,
    at: str | None,
    *,
    as_json: bool,
) -> None:
    """Print the structure of a Modelica model, its parameters and its operating point."""
    dae, report, kept = options.read_modelica(file, table_file, name, vary, at)
    point = modelica.operating_point(dae, report, kept)
    quantities: list[dict[str, Any]] = [
        {
            "name": q.name,
            "value": point.nominal[q.name],
            "unit": q.unit,
            "is": "found" if q.name in point.free else kind,
        }
        for kind, those in (("input", point.structure.inputs), ("state", point.structure.states))
        for q in those
    ]
    notes = [*str(report).splitlines(), *rooms.translation.notes_of_point(point)]
    if as_json:
        data = {"parameters": parameters_data(dae.parameters), "equilibrium": quantities}
        print_json({"name": dae.name, **data, "notes": notes})
        return
    say(str(point.structure))
    print_parameters(dae.parameters)
    rows = ((q["name"], f"{q['value']:.8g}", q["unit"], q["is"]) for q in quantities)
    where = "equilibrium" if point.at_rest else "start"
    print_table(f"{where}, parameters at nominal", "quantity | value > | unit | is", rows)
    say(*notes, "The model is usable.")


Plots = Annotated[
    options.Texts,
    typer.Option(
        help="Figure to draw, such as fig.png, of singular values; or bode=FILE, nyquist=FILE, "
        "nichols=FILE, step=FILE, order=FILE, poles=FILE, trim=FILE, poles:PARAMETER=FILE; may be "
        "repeated."
    ),
]
StoreProgram = Annotated[
    bool, typer.Option("--program", help="Store a straight-line program, too: many samples are fast.")
]


def linearize(
    file: ModelFile,
    output: options.Output = None,
    as_json: options.AsJson = False,
    search: options.Search = options.SEARCH,
    most_seconds: options.Seconds = None,
    prove: options.Prove = 1.0,
    truncate: Annotated[
        float | None,
        typer.Option(help="Relative error that a smaller model may have on the whole range."),
    ] = None,
    plot: Plots = None,
    width: options.FigureWidth = None,
    program: StoreProgram = False,
    table_file: TableFile = None,
    model_name: ModelName = None,
    vary: options.Vary = None,
    at: options.Point = None,
) -> None:
    """Linearize a scene or a Modelica model, parameters left in, and certify the result."""
    figures = _figures(plot or [])
    options.check_paths(output, *(figure for _, figure in figures))
    if program and output is None:
        raise AnalysisError("--program: it is stored in an archive; give one with -o.")
    with progress_of(file.stem) as progress:
        show = progress.stage
        if options.is_modelica(file):
            if truncate is not None:
                raise AnalysisError("--truncate is for scenes; truncate a finished model in Python.")
            model, seconds, notes = options.modelica_model(
                file, table_file, model_name, vary, at,
                search=search, seconds=most_seconds, prove=prove, progress=show,
            )  # fmt: skip
        else:
            _refuse_options(file, table_file, model_name, vary, at)
            start = time.perf_counter()
            scene = options.scene_in(file, model_name)
            if output is not None:  # else it would be found after the work
                rooms.archive.check_name(output, "model", scene.name)
            seconds = {"read": time.perf_counter() - start}
            model, stages, notes = _of_scene(scene, search, most_seconds, prove, show, truncate)
            seconds |= stages
        if program:
            model = batch.with_program(model)
        if output is not None:
            show("write")
            seconds["write"] = _written(output, model)
    files = {"archive": output}
    try:
        start = time.perf_counter()
        with options.on_paper(width):
            files |= _drawn(figures, model)
        seconds |= {"plot": time.perf_counter() - start} if figures else {}
    finally:  # a figure that fails takes neither the archive nor the table away
        report_model(model, seconds, files, notes, as_json=as_json)


def realize(
    matrix_file: Annotated[Path, typer.Argument(help="Matrix problem, a TOML file.")],
    output: options.Output = None,
    as_json: options.AsJson = False,
    search: options.Search = options.SEARCH,
    most_seconds: options.Seconds = None,
    prove: options.Prove = 1.0,
) -> None:
    """Make a certified model of a matrix that is rational in parameters."""
    options.check_paths(output)
    start = time.perf_counter()
    posed = matrix.load_matrix(matrix_file)
    seconds = {"read": time.perf_counter() - start}
    with progress_of(posed.name) as progress:
        how = {"seconds": most_seconds, "prove": prove, "progress": progress.stage}
        built = rooms.models.build_matrix(posed, search, **how)  # type: ignore[arg-type]
        seconds |= built.seconds
        if output is not None:
            progress.stage("write")
            seconds["write"] = _written(output, built.model)
    notes = [f"note: {name!r} is declared and not used." for name in rooms.problem.unused_names(posed)]
    report_model(built.model, seconds, {"archive": output}, notes, as_json=as_json)


def _written(archive: Path, model: "systems.LFTModel") -> float:
    """Save a model; return the seconds that this took."""
    start = time.perf_counter()
    archives.save(archive, model)
    return time.perf_counter() - start


def _drawn(figures: list[tuple[str, Path]], model: "systems.LFTModel") -> dict[str, Path | None]:
    """Draw all figures; then raise the first error, if there was one."""
    drawn: dict[str, Path | None] = {}
    failed: list[MbdlftError] = []
    for kind, figure in figures:
        name, _, over = kind.partition(":")
        try:
            draw(name, figure, model, over=over or None)
            drawn[f"figure of {kind}"] = figure
        except MbdlftError as error:
            failed.append(error)
    if failed:
        raise failed[0]
    return drawn


def _of_scene(
    scene: "multibody.Scene",
    search: float,
    most_seconds: float | None,
    prove: float,
    progress: Callable[[str], None],
    truncate: float | None,
) -> "tuple[systems.LFTModel, dict[str, float], list[str]]":
    """The linear model of a scene, the seconds of its stages, and notes."""
    built = rooms.models.build(
        scene, search, seconds=most_seconds, prove=prove, progress=progress, truncate=truncate
    )
    trim = built.model.trim
    notes = _notes(scene, trim.signals, [float(value) for value in trim.nominal])
    notes += [
        f"note: parameter {p.name!r} has no effect on this model."
        for p, count in zip(built.model.parameters, built.model.certificate.order, strict=True)
        if count == 0 and not any(f"parameter {p.name!r}" in note for note in notes)
    ]
    if truncate is not None and built.model.certificate.truncation_error == 0.0:
        notes.append(f"note: no channel can be left out within {truncate:g}; nothing is truncated.")
    return built.model, built.seconds, notes


def _notes(
    scene: "multibody.Scene", signals: Sequence["base.Signal"], values: Sequence[float]
) -> list[str]:
    """Lines with the notes on a scene; `signals` were unknown in the trim, with nominal `values`."""
    return [f"note: {text}" for text in multibody.notes(scene, dict(zip(signals, values, strict=True)))]


def _refuse_options(
    file: Path, table_file: Path | None, model_name: str | None, vary: list[str] | None, at: str | None
) -> None:
    """Raise an error if a scene comes with what is for Modelica models."""
    options_given = (("--parameters", table_file), ("--model", model_name), ("--at", at))
    for option, value in (*options_given, ("--vary", vary[0] if vary else None)):
        if value is not None and not (option == "--model" and options.is_robot(file)):
            raise AnalysisError(
                f"{option} {value}: it is for Modelica models ({', '.join(options.SUFFIXES)}); {file} is "
                "none."
            )


def _figures(texts: list[str]) -> list[tuple[str, Path]]:
    """Kinds and files of the options --plot FILE, --plot KIND=FILE, --plot KIND:PARAMETER=FILE."""
    figures = []
    for text in texts:
        kind, equals, file = text.partition("=")
        name, colon, over = kind.partition(":")
        if equals and name in (OVER if colon else KINDS) and bool(colon) == bool(over):
            figures.append((kind, Path(file)))
        elif equals and not kind.count("/"):
            raise AnalysisError(
                f"--plot {text}: unknown figure {kind!r}. Existing: {', '.join(sorted(KINDS))}; over a "
                f"parameter: {', '.join(f'{name}:PARAMETER' for name in OVER)}."
            )
        else:
            figures.append(("sigma", Path(text)))
    return figures
