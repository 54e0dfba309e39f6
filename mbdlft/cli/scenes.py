"""The commands `trim`, `import`, `body` and `schema`: equilibria of scenes, and what makes scenes."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mbdlft import elastic, multibody, problem, robot
from mbdlft.base.errors import MbdlftError, SceneError
from mbdlft.base.parameter import Angle, Parameter
from mbdlft.base.unit import ANGLE_UNITS
from mbdlft.cli import options, rooms
from mbdlft.cli.output import print_files, print_json, print_table, say, write_scene, write_text

if TYPE_CHECKING:
    from mbdlft.problem.trim import TrimPoint

_MOST_NAMES = 6  # of a list that is printed
_GROWS = 1e-6  # a real part below this part of the largest eigenvalue is zero


def trim(
    scene_file: Annotated[Path, typer.Argument(help="Scene, a TOML file.")],
    assignments: options.Values = None,
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
    as_json: options.AsJson = False,
) -> None:
    """Print the joint efforts that hold the equilibrium, or find the equilibrium."""
    values, scene = options.values_of(assignments), options.scene_in(scene_file)
    if positions or every or output:
        _print_equilibria(scene, values, starts, output, every=every, as_json=as_json)
        return
    equations = multibody.assemble(scene)
    point = problem.solve_trim(equations, values)
    if as_json:
        data = {"parameters": dict(point.parameters), "efforts": efforts_data(point)}
        print_json({"name": equations.name, **data, "residual": point.residual})
        return
    if point.parameters:
        rows = ((p.name, f"{point.parameters[p.name]:g}", p.unit) for p in equations.parameters)
        print_table(f"{equations.name}: parameters", "parameter | value > | unit", rows)
    print_efforts(point)
    say(f"relative residual {point.residual:.1e}")


def efforts_data(point: "TrimPoint") -> list[dict[str, object]]:
    """The efforts at a trim point as plain data."""
    pairs = zip(point.signals, point.values, strict=True)
    return [{"name": s.name, "value": value, "unit": s.unit} for s, value in pairs]


def print_efforts(point: "TrimPoint") -> None:
    """Print the table of the efforts at a trim point, and the names of those that are zero."""
    pairs = list(zip(point.signals, point.values, strict=True))
    if rows := [(signal.name, f"{value:.10g}", signal.unit) for signal, value in pairs if value]:
        print_table("efforts that hold the equilibrium", "effort | value > | unit", rows)
    if zero := [signal.name for signal, value in pairs if not value]:
        say(f"zero at equilibrium: {shortened_list(zero)}")


def shortened_list(names: Sequence[str]) -> str:
    """The first names of a list, and how many more there are."""
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more (--json has all)" if more > 0 else "")


def _print_equilibria(
    scene: "multibody.Scene",
    values: dict[str, float],
    starts: int,
    output: Path | None,
    *,
    every: bool,
    as_json: bool,
) -> None:
    """Find one equilibrium, or `every` one to which `starts` lead; write the scene at the first one."""
    if every:
        points = multibody.find_equilibrium(scene, values, starts=starts, every=True)
    else:
        points = (multibody.find_equilibrium(scene, values, starts=starts),)
    if output is not None:
        write_scene(output, multibody.at_equilibrium(scene, points[0]))
    if as_json:
        data = [_equilibrium_data(scene, point) for point in points]
        written = {} if output is None else {"scene": str(output)}
        print_json({"name": scene.name, "equilibria": data, **written})
        return
    for k, point in enumerate(points, start=1):
        unknowns = {**point.positions, **point.efforts}
        rows = ((name, f"{value + 0.0:.10g}", point.units[name]) for name, value in unknowns.items())
        print_table(f"{scene.name}: equilibrium {k}", "unknown | value > | unit", rows)
        say(f"residual {point.residual:.1e} of the largest terms; {_stability(scene, point)}")
        if point.undetermined:
            say(f"not determined: {', '.join(point.undetermined)}")
    if output is not None:
        say(f"scene at equilibrium 1: {output}" if len(points) > 1 else f"scene: {output}")


def _equilibrium_data(scene: "multibody.Scene", point: "multibody.EquilibriumPoint") -> dict[str, object]:
    """An equilibrium as plain data."""
    unknowns = {**point.positions, **point.efforts}
    return {
        "found": [
            {"name": name, "value": value, "unit": point.units[name]} for name, value in unknowns.items()
        ],
        "residual": point.residual,
        "stability": _stability(scene, point),
        "not determined": list(point.undetermined),
    }


def _stability(scene: "multibody.Scene", point: "multibody.EquilibriumPoint") -> str:
    """A sentence that says whether an equilibrium is stable."""
    try:
        eigenvalues = multibody.eigenvalues_at(scene, point)
    except MbdlftError as error:
        return f"stability not known: {error}"
    real, largest = float(eigenvalues[0].real), float(max(abs(eigenvalues)))
    if abs(real) <= _GROWS * largest:
        return "neither stable nor unstable: something moves without damping"
    if real > 0.0:
        return f"unstable: grows with {real:.3g} rad/s"
    return f"stable: decays with {-real:.3g} rad/s"


Labels = Annotated[
    options.Texts,
    typer.Option(
        "--set",
        help="LABEL=VALUE, such as tool0.mass=payload or elbow_joint.position=30*deg; numbers "
        "are in SI units; may be repeated.",
    ),
]
Declared = Annotated[
    options.Texts,
    typer.Option(
        "--parameter",
        help="NAME=LOW,NOMINAL,HIGH,UNIT for --set, such as payload=0,2,5,kg; may be repeated.",
    ),
]
Vary = Annotated[
    options.Texts,
    typer.Option(
        "--vary",
        help="LABEL=PERCENT: a parameter around the number of the file, such as "
        "forearm_link.mass=20; may be repeated.",
    ),
]
FreeBase = Annotated[
    bool | None,
    typer.Option(
        "--free-base/--fixed-base", help="Leave the root free, or clamp it; by default as the file says."
    ),
]


def import_robot(
    robot_file: Annotated[Path, typer.Argument(help="Robot, a URDF, SDF or MJCF file.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Scene to write, a TOML file.")],
    assignments: Labels = None,
    parameters: Declared = None,
    vary: Vary = None,
    moving: Annotated[
        options.Texts,
        typer.Option("--moving", help="Joint that moves, the others are locked; may be repeated."),
    ] = None,
    free_base: FreeBase = None,
    keep_unphysical: Annotated[
        bool, typer.Option("--keep-unphysical", help="Keep inertias that no body can have.")
    ] = False,
    model: Annotated[
        str | None, typer.Option("--model", help="Which model of an SDF file with several.")
    ] = None,
    keyframe: Annotated[
        str | None, typer.Option("--keyframe", help="Keyframe of an MJCF file whose positions are taken.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Make a scene of a robot (URDF, SDF, MJCF), and say what was ignored and what was assumed."""
    options.check_different(robot_file, output)
    scene, report = robot.load_robot(
        robot_file,
        parameters=[_parameter(text) for text in parameters or []],
        values=_pairs("--set", assignments),
        vary={label: _number("--vary", label, value) for label, value in _pairs("--vary", vary).items()},
        moving=moving,
        base=None if free_base is None else "free" if free_base else "fixed",
        keep_unphysical=keep_unphysical,
        model=model,
        keyframe=keyframe,
    )
    write_scene(output, scene)
    if as_json:
        limits = [limit._asdict() for limit in report.limits]
        data = {"ignored": report.ignored, "assumed": report.assumed, "limits": limits}
        print_json({"name": scene.name, "scene": str(output), **data})
        return
    say(
        str(report),
        f"{scene.name}: {len(scene.bodies)} bodies, {len(scene.joints)} joints, "
        f"{len(scene.parameters)} parameters.",
        f"scene: {output}",
    )


def _pairs(option: str, texts: options.Texts) -> dict[str, str]:
    """Texts by name of an option."""

    def nonempty(value: str) -> str:
        if not value:
            raise ValueError
        return value

    return options.by_name(option, texts, "a name, = and a value.", nonempty)


def _number(option: str, name: str, value: str) -> float:
    """The number in the value of an option."""
    try:
        return float(value)
    except ValueError:
        raise SceneError(f"{option} {name}: expected a number, got {value!r}.") from None


def _parameter(text: str) -> Parameter:
    """Parameter of the text ``name=low,nominal,high,unit``; one in deg or rad is an angle."""
    ((name, value),) = _pairs("--parameter", [text]).items()
    *numbers, unit = (entry.strip() for entry in value.split(","))
    if len(numbers) != 3:
        raise SceneError(
            f"--parameter {text}: expected NAME=LOW,NOMINAL,HIGH,UNIT, such as theta=-30,0,45,deg."
        )
    low, nominal, high = (_number("--parameter", name, number) for number in numbers)
    kind = Angle if unit in ANGLE_UNITS else Parameter
    return kind(name, nominal, low, high, unit=unit)


def body(
    body_file: Annotated[Path, typer.Argument(help="Catalogue body, a TOML file.")],
    name: Annotated[str | None, typer.Option(help="Name of the body in the scene.")] = None,
    method: Annotated[str | None, typer.Option(help="Component modes.")] = None,
    modes: Annotated[int | None, typer.Option(help="Number of modes.")] = None,
    frequency: Annotated[float | None, typer.Option(help="Highest frequency, rad/s.")] = None,
    effective_mass: Annotated[float | None, typer.Option(help="Fraction of the mass.")] = None,
    damping: Annotated[float | None, typer.Option(help="Damping ratio of all modes.")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Print the table of a catalogue body, to be pasted into a scene file."""
    chosen = {"method": method, "modes": modes, "frequency": frequency}
    chosen |= {"effective_mass": effective_mass, "damping": damping}
    choices: dict[str, Any] = {key: value for key, value in chosen.items() if value is not None}
    description = rooms.catalogue.body_table(body_file)
    notes = [f"{body_file.name}: {description['description']}", f"Source: {description['source']}"]
    toml = rooms.toml.body_to_toml(elastic.load_body(body_file, name, **choices))
    if "data" in description:
        reduced = rooms.catalogue.reduced_body(body_file, **choices)
        notes.append(elastic.effective_masses(reduced).table())
    if as_json:
        print_json({"toml": toml, "notes": notes})
        return
    lines = "\n".join(notes).splitlines()
    sys.stdout.write("".join(f"# {line}\n".replace(" \n", "\n") for line in lines) + f"\n{toml}")


def schema(
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File to write; else it is printed.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Write the JSON schema of scene files: editors complete and check keys and kinds with it."""
    text = json.dumps(multibody.scene_schema(), indent=2, ensure_ascii=False) + "\n"
    if output is None:
        sys.stdout.write(text)  # which is JSON
        return
    write_text(output, text)
    if as_json:
        print_files(("schema", output), as_json=True)
