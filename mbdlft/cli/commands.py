"""The command line: what makes, shows, analyzes and verifies models."""

import contextlib
import os
import sys
import time
import warnings
from collections.abc import Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from mbdlft import __version__
from mbdlft.base.errors import AnalysisError, MbdlftError, shortened
from mbdlft.cli.analysis import margin, verify, wcgain
from mbdlft.cli.body import body
from mbdlft.cli.export import export
from mbdlft.cli.poles import poles
from mbdlft.cli.report import print_model, report_model
from mbdlft.cli.response import KINDS, draw, response
from mbdlft.cli.schema import schema
from mbdlft.cli.source import values_of
from mbdlft.cli.sweep import sweep
from mbdlft.cli.tables import console as _console
from mbdlft.cli.tables import table as _table
from mbdlft.cli.urdf import import_robot
from mbdlft.cli.view import report, view
from mbdlft.system.model import LFTModel

if TYPE_CHECKING:
    from mbdlft.multibody.scene import Scene
    from mbdlft.problem.trim import TrimPoint

app = typer.Typer(
    help="Exact linear models of multibody systems, with their parameters left in.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
Output = Annotated[
    Path | None, typer.Option("-o", "--output", help="Archive to write the model into.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Search = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="Work to look for a smaller model, as parameters commute, about seconds of one core; "
        "0: none.",
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option("--seconds", min=0.0, help="Upper limit of the time of the search (s)."),
]
Prove = Annotated[
    float,
    typer.Option(
        min=0.0, help="Work to prove that the model is regular in the whole range, about seconds."
    ),
]
SceneFile = Annotated[Path, typer.Argument(help="Scene, a TOML file.")]
SEARCH = 4.0  # equal to SEARCH of mbdlft.pipeline.search, which is slow to import
app.command("import")(import_robot)
app.command()(body)
app.command()(margin)
app.command()(wcgain)
app.command()(verify)
app.command()(sweep)
app.command()(poles)
app.command()(response)
app.command()(export)
app.command()(view)
app.command()(report)
app.command()(schema)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """A warning is one line beside the output."""
    sys.stderr.write(f"mbdlft: warning: {message}\n")


def main() -> None:
    """Run the command line; bad input is one message and exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(
            stream, TextIOWrapper
        ):  # a letter that a terminal does not have is written as \\u
            stream.reconfigure(errors="backslashreplace")
    try:
        try:
            warnings.showwarning = _show_warning
            app()
        finally:
            sys.stdout.flush()
    except MbdlftError as error:
        _stop(str(error))
    except BrokenPipeError:
        _forget_output()  # whoever reads it wants no more
        sys.exit(1)
    except OSError as error:
        _forget_output()
        _stop(f"the output cannot be written: {error.strerror or error}.")


def _stop(message: str) -> NoReturn:
    """End with a message."""
    with contextlib.suppress(OSError):
        sys.stderr.write(f"mbdlft: {shortened(message)}\n")
    sys.exit(2)


def _forget_output() -> None:
    """Let what is not written yet go nowhere: the interpreter would try again when it ends."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        _console().print(f"mbdlft {__version__}")
        raise typer.Exit


@app.command()
def check(scene_file: SceneFile) -> None:
    """Check a scene, and trim and linearize it with numbers at nominal."""
    from mbdlft.multibody.assembly import assemble
    from mbdlft.multibody.scene import load_scene
    from mbdlft.multibody.to_problem import choose_signals
    from mbdlft.problem.relinearize import relinearize
    from mbdlft.problem.trim import solve_trim

    scene = load_scene(scene_file)
    equations = assemble(scene)
    inputs, outputs = choose_signals(scene, equations)
    point = solve_trim(equations)
    relinearize(equations, inputs, outputs, np.array([[p.nominal for p in equations.parameters]]))
    console = _console()
    console.print(
        f"{scene.name}: {len(scene.bodies)} bodies, {len(scene.joints)} joints, "
        f"{len(equations.x_signals)} states, {len(scene.parameters)} parameters."
    )
    if equations.parameters:
        table = _table("parameters", "name", "unit", "low >", "nominal >", "high >", "role")
        for p in equations.parameters:
            table.add_row(p.name, p.unit, f"{p.low:g}", f"{p.nominal:g}", f"{p.high:g}", p.role)
        console.print(table)
    console.print(_efforts(point))
    for note in _notes(scene):
        console.print(note)
    console.print("The scene is usable.")


@app.command()
def trim(
    scene_file: SceneFile,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", help="name=value in the unit of the parameter; may be repeated."),
    ] = None,
    positions: Annotated[
        bool, typer.Option("--positions", help="Find the positions of joints that nothing holds.")
    ] = False,
    every: Annotated[
        bool, typer.Option("--all", help="Find all equilibria that random starts lead to.")
    ] = False,
    starts: Annotated[int, typer.Option(min=1, help="Starts of the search for positions.")] = 30,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Scene to write, at the equilibrium.")
    ] = None,
) -> None:
    """Print the joint efforts that hold the equilibrium, or find the equilibrium."""
    from mbdlft.multibody.assembly import assemble
    from mbdlft.multibody.scene import load_scene
    from mbdlft.problem.trim import solve_trim

    if positions or every or output:
        from mbdlft.cli.tables import print_equilibria

        values = values_of(assignments or [])
        print_equilibria(load_scene(scene_file), values, starts, output, every=every)
        return
    equations = assemble(load_scene(scene_file))
    point = solve_trim(equations, values_of(assignments or []))
    console = _console()
    if point.parameters:
        table = _table(f"{equations.name}: parameters", "parameter", "value >", "unit")
        for parameter in equations.parameters:
            value = point.parameters[parameter.name]
            table.add_row(parameter.name, f"{value:g}", parameter.unit)
        console.print(table)
    console.print(_efforts(point))
    console.print(f"relative residual {point.residual:.1e}")


@app.command()
def linearize(
    scene_file: SceneFile,
    output: Output = None,
    as_json: AsJson = False,
    search: Search = SEARCH,
    most_seconds: Seconds = None,
    prove: Prove = 1.0,
    truncate: Annotated[
        float | None,
        typer.Option(help="Relative error that a smaller model may have on the whole range."),
    ] = None,
    plot: Annotated[
        list[str] | None,
        typer.Option(
            help="Figure to draw, such as fig.png, of singular values; or bode=FILE, poles=FILE, "
            "step=FILE; may be repeated."
        ),
    ] = None,
) -> None:
    """Linearize a scene, parameters left in, and certify the result."""
    from mbdlft.multibody.scene import load_scene
    from mbdlft.pipeline.build import build

    figures = _figures(plot or [])
    _check_paths(output, figures)
    seconds: dict[str, float] = {}
    start = time.perf_counter()
    scene = load_scene(scene_file)
    seconds["read"] = time.perf_counter() - start
    with Console(stderr=True).status("") as status:
        built = build(
            scene,
            search,
            seconds=most_seconds,
            prove=prove,
            progress=lambda stage: status.update(f"{escape(scene.name)}: {stage}"),
            truncate=truncate,
        )
        seconds |= {name: value for name, value in built.seconds.items() if name != "total"}
        if output is not None:
            status.update(f"{escape(scene.name)}: write")
            seconds["write"] = _write(output, built.model)
    notes = _notes(scene)
    if truncate is not None and built.model.certificate.truncation_error == 0.0:
        notes.append(f"note: no channel can be left out within {truncate:g}; nothing is truncated.")
    try:
        start = time.perf_counter()
        for kind, file in figures:
            draw(kind, file, built.model)
            seconds["plot"] = time.perf_counter() - start
    finally:  # a figure that fails takes neither the archive nor the table away
        files = {"archive": output, **{f"figure of {kind}": file for kind, file in figures}}
        report_model(built.model, seconds, files, notes, as_json=as_json)


@app.command()
def realize(
    matrix_file: Annotated[Path, typer.Argument(help="Matrix problem, a TOML file.")],
    output: Output = None,
    as_json: AsJson = False,
    search: Search = SEARCH,
    most_seconds: Seconds = None,
    prove: Prove = 1.0,
    exact: Annotated[
        bool, typer.Option("--exact", help="Prove the lower bound in exact arithmetic.")
    ] = False,
) -> None:
    """Make a certified model of a matrix that is rational in parameters."""
    from mbdlft.matrix import load_matrix
    from mbdlft.matrix.problem import unused_names
    from mbdlft.pipeline.build import build_matrix

    _check_paths(output)
    start = time.perf_counter()
    problem = load_matrix(matrix_file)
    seconds = {"read": time.perf_counter() - start}
    with Console(stderr=True).status("") as status:
        built = build_matrix(
            problem,
            search,
            seconds=most_seconds,
            prove=prove,
            exact=exact,
            progress=lambda stage: status.update(f"{escape(problem.name)}: {stage}"),
        )
        seconds |= {name: value for name, value in built.seconds.items() if name != "total"}
        if output is not None:
            status.update(f"{escape(problem.name)}: write")
            seconds["write"] = _write(output, built.model)
    notes = [f"note: {name!r} is declared and not used." for name in unused_names(problem)]
    report_model(built.model, seconds, {"archive": output}, notes, as_json=as_json)


@app.command()
def show(
    archive: Annotated[Path, typer.Argument(help="Archive, an HDF5 file.")],
    name: Annotated[str | None, typer.Option(help="Only the model of this name.")] = None,
) -> None:
    """Print what is in an archive."""
    from mbdlft.store import load, model_names, sweep_names

    for key in [name] if name else model_names(archive):
        model = load(archive, key)
        functions = getattr(model, "functions", ())
        model = getattr(model, "linear", model)
        print_model(model)
        for function in functions:
            _console().print(f"nonlinear: {function}", highlight=False, markup=False)
        if not isinstance(model, LFTModel):
            continue
        made = model.provenance
        _console().print(f"made {made.created} by mbdlft {made.mbdlft}, CasADi {made.casadi}")
    if name is None and sweep_names(archive):
        _console().print(f"sweeps: {', '.join(sweep_names(archive))}", highlight=False)


def _efforts(point: "TrimPoint") -> Table:
    """The table of the efforts at a trim point."""
    table = _table("efforts that hold the equilibrium", "effort", "value >", "unit")
    for signal, value in zip(point.signals, point.values, strict=True):
        table.add_row(signal.name, f"{value:.10g}", signal.unit)
    return table


def _notes(scene: "Scene") -> list[str]:
    """Notes on facts that a user may have overlooked."""
    from mbdlft.multibody.body import Beam
    from mbdlft.multibody.body.beam_errors import error_sentence
    from mbdlft.multibody.scene.quantities import unused_names

    notes = [f"{error_sentence(body)}." for body in scene.bodies if isinstance(body, Beam)]
    notes += [f"note: {name!r} is declared and not used." for name in unused_names(scene)]
    if not any(scene.gravity) and not any(scene.acceleration):
        notes.append("note: there is no gravity and no acceleration; both are zero by default.")
    return notes


def _figures(texts: list[str]) -> list[tuple[str, Path]]:
    """Kinds and files of the options --plot FILE and --plot KIND=FILE."""
    found = []
    for text in texts:
        kind, equals, file = text.partition("=")
        if equals and kind in KINDS:
            found.append((kind, Path(file)))
        elif equals and not kind.count("/"):
            raise AnalysisError(
                f"--plot {text}: unknown figure {kind!r}. Existing: {', '.join(sorted(KINDS))}."
            )
        else:
            found.append(("sigma", Path(text)))
    return found


def _check_paths(archive: Path | None, figures: Sequence[tuple[str, Path]] = ()) -> None:
    """Raise an error if it is known before the work that one of the files cannot be written."""
    if archive is not None:
        from mbdlft.store.archive import check_file

        check_file(archive)
    for _, file in figures:
        from mbdlft.plot import check_figure

        check_figure(file)


def _write(archive: Path, model: LFTModel) -> float:
    """Save a model; return the seconds that this took."""
    from mbdlft.store import save

    start = time.perf_counter()
    save(archive, model)
    return time.perf_counter() - start
