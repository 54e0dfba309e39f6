"""The commands that make models and scenes: `check`, `linearize`, `import` of robots, `body`."""

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.table import Table

from mbdlft.base.errors import AnalysisError, MbdlftError, SceneError
from mbdlft.base.parameter import Angle, Parameter
from mbdlft.base.unit import ANGLE_UNITS
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
from mbdlft.cli.output import console as _console
from mbdlft.cli.output import parameters_data, print_json, progress_of, write_scene
from mbdlft.cli.output import table as _table
from mbdlft.cli.responses import KINDS, OVER, draw
from mbdlft.cli.sources import (
    SUFFIXES,
    Asked,
    check_modelica,
    is_modelica,
    is_robot,
    linear_model,
    scene_in,
)
from mbdlft.cli.summary import report_model
from mbdlft.system.model import LFTModel

if TYPE_CHECKING:
    from mbdlft.base.unit import Signal
    from mbdlft.multibody.scene import Scene
    from mbdlft.problem.trim import TrimPoint

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
StoreProgram = Annotated[
    bool,
    typer.Option("--program", help="Store a straight-line program, too: many samples are fast."),
]
Plots = Annotated[
    list[str] | None,
    typer.Option(
        help="Figure to draw, such as fig.png, of singular values; or bode=FILE, step=FILE, "
        "order=FILE, poles=FILE, trim=FILE, poles:PARAMETER=FILE; may be repeated."
    ),
]
ModelName = Annotated[
    str | None, typer.Option("--model", help="Which model of a .mo or .sdf file with several.")
]


def check(
    file: ModelFile,
    table_file: TableFile = None,
    model_name: ModelName = None,
    as_json: AsJson = False,
) -> None:
    """Check a scene, a robot or a Modelica model, and trim it at nominal."""
    if is_modelica(file):
        check_modelica(Asked(file, table_file, model_name), as_json=as_json)
        return
    _refuse_options(file, table_file, model_name)
    from mbdlft.multibody.assembly import assemble
    from mbdlft.multibody.to_problem import choose_signals
    from mbdlft.problem.linearization import relinearize
    from mbdlft.problem.trim import solve_trim

    scene = scene_in(file, model_name)
    equations = assemble(scene)
    inputs, outputs = choose_signals(scene, equations)
    point = solve_trim(equations)
    relinearize(equations, inputs, outputs, np.array([[p.nominal for p in equations.parameters]]))
    said = _notes(scene, point.signals, point.values)
    if as_json:
        print_json(
            {
                "name": scene.name,
                "bodies": len(scene.bodies),
                "joints": len(scene.joints),
                "states": len(equations.x_signals),
                "parameters": parameters_data(equations.parameters),
                "efforts": efforts_data(point),
                "notes": said,
            }
        )
        return
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
    console.print(efforts_table(point))
    for note in said:
        console.print(note, highlight=False)
    console.print("The scene is usable.")


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
    _check_output(output, figures, program)
    asked = Asked(file, table_file, model_name)
    with progress_of(file.stem) as progress:
        show = progress.stage
        if is_modelica(file):
            if truncate is not None:
                raise AnalysisError(
                    "--truncate is for scenes; truncate a finished model in Python."
                )
            model, seconds, notes = linear_model(asked, search, most_seconds, prove, show)
        else:
            _refuse_options(*asked)
            start = time.perf_counter()
            scene = scene_in(file, model_name)
            read = {"read": time.perf_counter() - start}
            model, seconds, notes = _of_scene(scene, search, most_seconds, prove, show, truncate)
            seconds = read | seconds
        if program:
            from mbdlft.batch import with_program

            model = with_program(model)
        if output is not None:
            show("write")
            seconds["write"] = write_model(output, model)
    files = {"archive": output}
    try:
        start = time.perf_counter()
        files |= _drawn(figures, model)
        seconds |= {"plot": time.perf_counter() - start} if figures else {}
    finally:  # a figure that fails takes neither the archive nor the table away
        report_model(model, seconds, files, notes, as_json=as_json)


def _check_output(output: Path | None, figures: list[tuple[str, Path]], program: bool) -> None:
    """Raise an error if it is known before the work that a file cannot be written."""
    check_paths(output, figures)
    if program and output is None:
        raise AnalysisError("--program: it is stored in an archive; give one with -o.")


def _drawn(figures: list[tuple[str, Path]], model: LFTModel) -> dict[str, Path | None]:
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
) -> tuple[LFTModel, dict[str, float], list[str]]:
    """The linear model of a scene, the seconds of its stages, and notes."""
    from mbdlft.pipeline.models import build

    built = build(
        scene,
        search,
        seconds=most_seconds,
        prove=prove,
        progress=progress,
        truncate=truncate,
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
    from mbdlft.multibody.overlooked import notes

    return [f"note: {text}" for text in notes(scene, dict(zip(signals, values, strict=True)))]


def _refuse_options(file: Path, table_file: Path | None, model_name: str | None) -> None:
    """Raise an error if a scene comes with what is for Modelica models."""
    for option, value in (("--parameters", table_file), ("--model", model_name)):
        if value is not None and not (option == "--model" and is_robot(file)):
            raise AnalysisError(
                f"{option} {value}: it is for Modelica models ({', '.join(SUFFIXES)}); {file} is none."
            )


def efforts_data(point: "TrimPoint") -> list[dict[str, object]]:
    """The efforts at a trim point as plain data."""
    pairs = zip(point.signals, point.values, strict=True)
    return [{"name": s.name, "value": value, "unit": s.unit} for s, value in pairs]


def efforts_table(point: "TrimPoint") -> Table:
    """The table of the efforts at a trim point."""
    table = _table("efforts that hold the equilibrium", "effort", "value >", "unit")
    for signal, value in zip(point.signals, point.values, strict=True):
        table.add_row(signal.name, f"{value + 0.0:.10g}", signal.unit)
    return table


def _figures(texts: list[str]) -> list[tuple[str, Path]]:
    """Kinds and files of the options --plot FILE, --plot KIND=FILE, --plot KIND:PARAMETER=FILE."""
    found = []
    for text in texts:
        kind, equals, file = text.partition("=")
        name, colon, over = kind.partition(":")
        if equals and name in (OVER if colon else KINDS) and bool(colon) == bool(over):
            found.append((kind, Path(file)))
        elif equals and not kind.count("/"):
            raise AnalysisError(
                f"--plot {text}: unknown figure {kind!r}. Existing: {', '.join(sorted(KINDS))}; over a "
                f"parameter: {', '.join(f'{name}:PARAMETER' for name in OVER)}."
            )
        else:
            found.append(("sigma", Path(text)))
    return found


Texts = list[str] | None
Declared = Annotated[
    Texts,
    typer.Option(
        "--parameter",
        help="NAME=LOW,NOMINAL,HIGH,UNIT for --set, such as payload=0,2,5,kg; may be repeated.",
    ),
]
Vary = Annotated[
    Texts,
    typer.Option(
        "--vary",
        help="LABEL=PERCENT: a parameter around the number of the file, such as "
        "forearm_link.mass=20; may be repeated.",
    ),
]
Keyframe = Annotated[
    str | None,
    typer.Option("--keyframe", help="Keyframe of an MJCF file whose positions are taken."),
]


def import_robot(
    robot_file: Annotated[Path, typer.Argument(help="Robot, a URDF, SDF or MJCF file.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Scene to write, a TOML file.")],
    assignments: Annotated[
        Texts,
        typer.Option(
            "--set",
            help="LABEL=VALUE, such as tool0.mass=payload or elbow_joint.position=30*deg; numbers "
            "are in SI units; may be repeated.",
        ),
    ] = None,
    parameters: Declared = None,
    vary: Vary = None,
    moving: Annotated[
        Texts,
        typer.Option("--moving", help="Joint that moves, the others are locked; may be repeated."),
    ] = None,
    free_base: Annotated[
        bool | None,
        typer.Option(
            "--free-base/--fixed-base",
            help="Leave the root free, or clamp it; by default as the file says.",
        ),
    ] = None,
    keep_unphysical: Annotated[
        bool, typer.Option("--keep-unphysical", help="Keep inertias that no body can have.")
    ] = False,
    model: Annotated[
        str | None, typer.Option("--model", help="Which model of an SDF file with several.")
    ] = None,
    keyframe: Keyframe = None,
    as_json: AsJson = False,
) -> None:
    """Make a scene of a robot (URDF, SDF, MJCF), and say what was ignored and what was assumed."""
    from mbdlft.robot import load_robot

    percents = dict(_pair("--vary", text) for text in vary or [])
    scene, report = load_robot(
        robot_file,
        parameters=[_parameter(text) for text in parameters or []],
        values=dict(_pair("--set", text) for text in assignments or []),
        vary={label: _number("--vary", label, value) for label, value in percents.items()},
        moving=moving,
        base=None if free_base is None else "free" if free_base else "fixed",
        keep_unphysical=keep_unphysical,
        model=model,
        keyframe=keyframe,
    )
    write_scene(output, scene)
    if as_json:
        limits = [limit._asdict() for limit in report.limits]
        said = {"ignored": report.ignored, "assumed": report.assumed, "limits": limits}
        print_json({"name": scene.name, "scene": str(output), **said})
        return
    typer.echo(str(report))
    typer.echo(
        f"{scene.name}: {len(scene.bodies)} bodies, {len(scene.joints)} joints, "
        f"{len(scene.parameters)} parameters."
    )
    typer.echo(f"scene: {output}")


def _pair(option: str, text: str) -> tuple[str, str]:
    """Name and value of the text ``name=value`` of an option."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not (name and equals and value):
        raise SceneError(f"{option} {text}: expected a name, = and a value.")
    return name, value


def _number(option: str, name: str, value: str) -> float:
    """The number in the value of an option."""
    try:
        return float(value)
    except ValueError:
        raise SceneError(f"{option} {name}: expected a number, got {value!r}.") from None


def _parameter(text: str) -> Parameter:
    """Parameter of the text ``name=low,nominal,high,unit``; one in deg or rad is an angle."""
    name, value = _pair("--parameter", text)
    parts = [part.strip() for part in value.split(",")]
    if len(parts) != 4:
        raise SceneError(
            f"--parameter {text}: expected NAME=LOW,NOMINAL,HIGH,UNIT, such as theta=-30,0,45,deg."
        )
    low, nominal, high = (_number("--parameter", name, part) for part in parts[:3])
    kind = Angle if parts[3] in ANGLE_UNITS else Parameter
    return kind(name, nominal, low, high, unit=parts[3])


def body(
    body_file: Annotated[Path, typer.Argument(help="Catalogue body, a TOML file.")],
    name: Annotated[str | None, typer.Option(help="Name of the body in the scene.")] = None,
    method: Annotated[str | None, typer.Option(help="Component modes.")] = None,
    modes: Annotated[int | None, typer.Option(help="Number of modes.")] = None,
    frequency: Annotated[float | None, typer.Option(help="Highest frequency, rad/s.")] = None,
    effective_mass: Annotated[float | None, typer.Option(help="Fraction of the mass.")] = None,
    damping: Annotated[float | None, typer.Option(help="Damping ratio of all modes.")] = None,
    as_json: AsJson = False,
) -> None:
    """Print the table of a catalogue body, to be pasted into a scene file."""
    from mbdlft.elastic.catalogue import body_table, load_body, reduced_body
    from mbdlft.elastic.model import effective_masses
    from mbdlft.multibody.scene.toml import body_to_toml

    given = {"method": method, "modes": modes, "frequency": frequency}
    given |= {"effective_mass": effective_mass, "damping": damping}
    choices = {key: value for key, value in given.items() if value is not None}
    table = body_table(body_file)
    notes = [f"{body_file.name}: {table['description']}", f"Source: {table['source']}"]
    catalogue_body = load_body(body_file, name, **choices)
    if "data" in table:
        notes.append(effective_masses(reduced_body(body_file, **choices)).table())
    if as_json:
        print_json({"toml": body_to_toml(catalogue_body), "notes": notes})
        return
    comment = "\n".join(notes)
    sys.stdout.write("".join(f"# {line}\n".replace(" \n", "\n") for line in comment.splitlines()))
    sys.stdout.write(f"\n{body_to_toml(catalogue_body)}")
