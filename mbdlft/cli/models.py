"""The commands `check`, `linearize`, `realize`: models of scenes, robots, Modelica models, matrices."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from mbdlft import archive as archives
from mbdlft import batch, matrix, modelica, multibody, problem
from mbdlft.base.errors import AnalysisError, MbdlftError
from mbdlft.cli import rooms
from mbdlft.cli.options import SEARCH, AsJson, Output, Prove, Search, Seconds, Texts, check_paths
from mbdlft.cli.output import parameters_data, print_json, print_parameters, print_table, progress_of, say
from mbdlft.cli.responses import KINDS, OVER, draw
from mbdlft.cli.scenes import efforts_data, print_efforts
from mbdlft.cli.sources import SUFFIXES, is_modelica, is_robot, modelica_model, read_modelica, scene_in
from mbdlft.cli.summary import report_model

if TYPE_CHECKING:
    from mbdlft.base.unit import Signal
    from mbdlft.multibody import Scene
    from mbdlft.system import LFTModel

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
    file: ModelFile, table_file: TableFile = None, model_name: ModelName = None, as_json: AsJson = False
) -> None:
    """Check a scene, a robot or a Modelica model, and trim it at nominal."""
    if is_modelica(file):
        _check_modelica(file, table_file, model_name, as_json=as_json)
        return
    _refuse_options(file, table_file, model_name)
    scene = scene_in(file, model_name)
    equations = multibody.assemble(scene)
    inputs, outputs = rooms.to_problem.choose_signals(scene, equations)
    point = problem.solve_trim(equations)
    rooms.linearization.relinearize(
        equations, inputs, outputs, np.array([[p.nominal for p in equations.parameters]])
    )
    notes = _notes(scene, point.signals, point.values)
    counts = {
        "bodies": len(scene.bodies),
        "joints": len(scene.joints),
        "states": len(equations.x_signals),
    }
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


def _check_modelica(file: Path, table_file: Path | None, name: str | None, *, as_json: bool) -> None:
    """Print the structure of a Modelica model, its parameters and its equilibrium."""
    dae, report, kept = read_modelica(file, table_file, name)
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
    notes = str(report).splitlines()
    if as_json:
        data = {"parameters": parameters_data(dae.parameters), "equilibrium": quantities}
        print_json({"name": dae.name, **data, "notes": notes})
        return
    say(str(point.structure))
    print_parameters(dae.parameters)
    rows = ((q["name"], f"{q['value']:.8g}", q["unit"], q["is"]) for q in quantities)
    print_table("equilibrium, parameters at nominal", "quantity | value > | unit | is", rows)
    say(*notes, "The model is usable.")


Plots = Annotated[
    Texts,
    typer.Option(
        help="Figure to draw, such as fig.png, of singular values; or bode=FILE, step=FILE, "
        "order=FILE, poles=FILE, trim=FILE, poles:PARAMETER=FILE; may be repeated."
    ),
]
StoreProgram = Annotated[
    bool, typer.Option("--program", help="Store a straight-line program, too: many samples are fast.")
]


def linearize(
    file: ModelFile,
    output: Output = None,
    as_json: AsJson = False,
    search: Search = SEARCH,
    most_seconds: Seconds = None,
    prove: Prove = 1.0,
    truncate: Annotated[
        float | None,
        typer.Option(help="Relative error that a smaller model may have on the whole range."),
    ] = None,
    plot: Plots = None,
    program: StoreProgram = False,
    table_file: TableFile = None,
    model_name: ModelName = None,
) -> None:
    """Linearize a scene or a Modelica model, parameters left in, and certify the result."""
    figures = _figures(plot or [])
    check_paths(output, *(figure for _, figure in figures))
    if program and output is None:
        raise AnalysisError("--program: it is stored in an archive; give one with -o.")
    with progress_of(file.stem) as progress:
        show = progress.stage
        if is_modelica(file):
            if truncate is not None:
                raise AnalysisError("--truncate is for scenes; truncate a finished model in Python.")
            model, seconds, notes = modelica_model(
                file, table_file, model_name,
                search=search, seconds=most_seconds, prove=prove, progress=show,
            )  # fmt: skip
        else:
            _refuse_options(file, table_file, model_name)
            start = time.perf_counter()
            scene = scene_in(file, model_name)
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
        files |= _drawn(figures, model)
        seconds |= {"plot": time.perf_counter() - start} if figures else {}
    finally:  # a figure that fails takes neither the archive nor the table away
        report_model(model, seconds, files, notes, as_json=as_json)


def realize(
    matrix_file: Annotated[Path, typer.Argument(help="Matrix problem, a TOML file.")],
    output: Output = None,
    as_json: AsJson = False,
    search: Search = SEARCH,
    most_seconds: Seconds = None,
    prove: Prove = 1.0,
) -> None:
    """Make a certified model of a matrix that is rational in parameters."""
    check_paths(output)
    start = time.perf_counter()
    posed = matrix.load_matrix(matrix_file)
    seconds = {"read": time.perf_counter() - start}
    with progress_of(posed.name) as progress:
        how = {"seconds": most_seconds, "prove": prove, "progress": progress.stage}
        built = rooms.models.build_matrix(posed, search, **how)  # type: ignore[arg-type]
        seconds |= {name: value for name, value in built.seconds.items() if name != "total"}
        if output is not None:
            progress.stage("write")
            seconds["write"] = _written(output, built.model)
    notes = [f"note: {name!r} is declared and not used." for name in rooms.problem.unused_names(posed)]
    report_model(built.model, seconds, {"archive": output}, notes, as_json=as_json)


def _written(archive: Path, model: "LFTModel") -> float:
    """Save a model; return the seconds that this took."""
    start = time.perf_counter()
    archives.save(archive, model)
    return time.perf_counter() - start


def _drawn(figures: list[tuple[str, Path]], model: "LFTModel") -> dict[str, Path | None]:
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
    scene: "Scene",
    search: float,
    most_seconds: float | None,
    prove: float,
    progress: Callable[[str], None],
    truncate: float | None,
) -> "tuple[LFTModel, dict[str, float], list[str]]":
    """The linear model of a scene, the seconds of its stages, and notes."""
    built = rooms.models.build(
        scene, search, seconds=most_seconds, prove=prove, progress=progress, truncate=truncate
    )
    seconds = {name: value for name, value in built.seconds.items() if name != "total"}
    trim = built.model.trim
    notes = _notes(scene, trim.signals, [float(value) for value in trim.nominal])
    notes += [
        f"note: parameter {p.name!r} has no effect on this model."
        for p, count in zip(built.model.parameters, built.model.certificate.order, strict=True)
        if count == 0 and not any(f"parameter {p.name!r}" in note for note in notes)
    ]
    if truncate is not None and built.model.certificate.truncation_error == 0.0:
        notes.append(f"note: no channel can be left out within {truncate:g}; nothing is truncated.")
    return built.model, seconds, notes


def _notes(scene: "Scene", signals: Sequence["Signal"], values: Sequence[float]) -> list[str]:
    """Lines with the notes on a scene; `signals` were unknown in the trim, with nominal `values`."""
    return [f"note: {text}" for text in multibody.notes(scene, dict(zip(signals, values, strict=True)))]


def _refuse_options(file: Path, table_file: Path | None, model_name: str | None) -> None:
    """Raise an error if a scene comes with what is for Modelica models."""
    for option, value in (("--parameters", table_file), ("--model", model_name)):
        if value is not None and not (option == "--model" and is_robot(file)):
            raise AnalysisError(
                f"{option} {value}: it is for Modelica models ({', '.join(SUFFIXES)}); {file} is none."
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
