"""The command `import`: it makes a scene of a robot's file."""

from pathlib import Path
from typing import Annotated

import typer

from mbdlft.base.errors import SceneError
from mbdlft.base.parameter import Angle, Parameter
from mbdlft.base.unit import ANGLE_UNITS
from mbdlft.cli.options import AsJson
from mbdlft.cli.tables import print_json, write_scene

Texts = list[str] | None
ModelName = Annotated[
    str | None, typer.Option("--model", help="Which model of an SDF file with several.")
]
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
    model: ModelName = None,
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
