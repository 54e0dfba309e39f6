"""The command line: what makes, shows, analyzes and verifies models."""

import contextlib
import os
import sys
import time
import warnings
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from mbdlft import __version__
from mbdlft.base.errors import MbdlftError, shortened
from mbdlft.cli.bounds import margin, verify, wcgain, worst
from mbdlft.cli.files import export, report, schema, sweep, view
from mbdlft.cli.models import body, check, efforts_data, efforts_table, import_robot, linearize
from mbdlft.cli.options import (
    SEARCH,
    AsJson,
    Output,
    Prove,
    Search,
    Seconds,
    check_paths,
    write_model,
)
from mbdlft.cli.output import WARNINGS, print_json, progress_of, warn
from mbdlft.cli.output import console as _console
from mbdlft.cli.output import table as _table
from mbdlft.cli.responses import poles, response
from mbdlft.cli.sources import scene_in, values_of
from mbdlft.cli.summary import archive_data, beside_models, print_model, report_model
from mbdlft.system.model import LFTModel

app = typer.Typer(
    help="Exact linear models of multibody systems, with their parameters left in.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
SceneFile = Annotated[Path, typer.Argument(help="Scene, a TOML file.")]
app.command()(check)
app.command()(linearize)
app.command("import")(import_robot)
app.command()(body)
app.command()(margin)
app.command()(wcgain)
app.command()(worst)
app.command()(verify)
app.command()(sweep)
app.command()(poles)
app.command()(response)
app.command()(export)
app.command()(view)
app.command()(report)
app.command()(schema)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """A warning of Python is shown as those of the commands are."""
    warn(message)


def main() -> None:
    """Run the command line; bad input is one message and exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(
            stream, TextIOWrapper
        ):  # a letter that a terminal does not have is written as \\u
            stream.reconfigure(errors="backslashreplace")
    try:
        try:
            WARNINGS.clear()
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
    as_json: AsJson = False,
) -> None:
    """Print the joint efforts that hold the equilibrium, or find the equilibrium."""
    from mbdlft.multibody.assembly import assemble
    from mbdlft.problem.trim import solve_trim

    if positions or every or output:
        from mbdlft.cli.output import print_equilibria

        values = values_of(assignments or [])
        scene = scene_in(scene_file)
        print_equilibria(scene, values, starts, output, every=every, as_json=as_json)
        return
    equations = assemble(scene_in(scene_file))
    point = solve_trim(equations, values_of(assignments or []))
    if as_json:
        found = {"parameters": dict(point.parameters), "efforts": efforts_data(point)}
        print_json({"name": equations.name, **found, "residual": point.residual})
        return
    console = _console()
    if point.parameters:
        table = _table(f"{equations.name}: parameters", "parameter", "value >", "unit")
        for parameter in equations.parameters:
            value = point.parameters[parameter.name]
            table.add_row(parameter.name, f"{value:g}", parameter.unit)
        console.print(table)
    console.print(efforts_table(point))
    console.print(f"relative residual {point.residual:.1e}")


@app.command()
def realize(
    matrix_file: Annotated[Path, typer.Argument(help="Matrix problem, a TOML file.")],
    output: Output = None,
    as_json: AsJson = False,
    search: Search = SEARCH,
    most_seconds: Seconds = None,
    prove: Prove = 1.0,
) -> None:
    """Make a certified model of a matrix that is rational in parameters."""
    from mbdlft.matrix import load_matrix
    from mbdlft.matrix.problem import unused_names
    from mbdlft.pipeline.models import build_matrix

    check_paths(output)
    start = time.perf_counter()
    problem = load_matrix(matrix_file)
    seconds = {"read": time.perf_counter() - start}
    with progress_of(problem.name) as progress:
        built = build_matrix(
            problem,
            search,
            seconds=most_seconds,
            prove=prove,
            progress=progress.stage,
        )
        seconds |= {name: value for name, value in built.seconds.items() if name != "total"}
        if output is not None:
            progress.stage("write")
            seconds["write"] = write_model(output, built.model)
    notes = [f"note: {name!r} is declared and not used." for name in unused_names(problem)]
    report_model(built.model, seconds, {"archive": output}, notes, as_json=as_json)


@app.command()
def show(
    archive: Annotated[Path, typer.Argument(help="Archive, an HDF5 file.")],
    name: Annotated[str | None, typer.Option(help="Only the model of this name.")] = None,
    as_json: AsJson = False,
) -> None:
    """Print what is in an archive, and from when."""
    from mbdlft.archive.archive import load, model_names

    if as_json:
        print_json(archive_data(archive, name))
        return
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
        if model.known_program is not None:
            _console().print(f"stored program: {model.known_program.length} instructions")
    if name is None:
        for line in beside_models(archive):
            _console().print(line, highlight=False, soft_wrap=True)
