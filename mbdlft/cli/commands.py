"""The command line: a table of commands, whose modules are imported when one is called, and `main`."""

import contextlib
import os
import re
import sys
import warnings
from collections.abc import Callable
from functools import partial
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from mbdlft import __version__
from mbdlft.base.errors import MbdlftError, shortened

# name of a command, its module (with the function, if that has another name), first line of its help
_TABLE = """
check models: Check a scene, a robot or a Modelica model, and trim it at nominal.
linearize models: Linearize a scene or a Modelica model, parameters left in, and certify the result.
import scenes:import_robot:
    Make a scene of a robot (URDF, SDF, MJCF), and say what was ignored and what was assumed.
body scenes: Print the table of a catalogue body, to be pasted into a scene file.
margin bounds: Bounds of the margin of robust stability, proved for all frequencies and values.
wcgain bounds: Bounds of the largest gain over the declared ranges, proved for all frequencies and values.
worst bounds: The worst real part, damping, disk margin or H2 norm over the ranges, with proved bounds.
verify bounds: Check every stored proof again, without a search.
tune bounds: Tune controllers for goals at the worst values of the parameters, and prove the result.
simulate responses: Simulate the motion of a scene, of any size, beside its linear model.
sweep files: Trim and linearize at many samples; the same command goes on after a kill.
poles responses: Print poles with their damping, transmission zeros, and whether values make it unstable.
response responses: Print norms, the worst of random samples, and values at frequencies.
export files: Write a model for another tool, or its matrices on a grid.
view files: Write a web page that shows a scene, with sliders, loads at equilibrium and moving modes.
report files: Write a page on a model: scene, parameters, what is proved, equilibrium, poles, responses.
schema scenes: Write the JSON schema of scene files: editors complete and check keys and kinds with it.
trim scenes: Print the joint efforts that hold the equilibrium, or find the equilibrium.
realize models: Make a certified model of a matrix that is rational in parameters.
show models: Print what is in an archive, and from when.
"""
# name of the command: its module and function, and the first line of its help
COMMANDS = {
    name: (module if ":" in module else f"{module}:{name}", text)
    for name, module, text in re.findall(r"(?m)^(\S+) (\S+):\s+(.*)$", _TABLE)
}
WARNINGS: list[str] = []  # that this command has shown


class _Group(TyperGroup):
    """Commands by name and help; the module of one is imported when it is called or completed."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the options of the group; typer would import pydantic to check one that is not there."""
        for option in self.get_params(ctx):
            option.process_value = partial(_checked, option.process_value)  # type: ignore[method-assign]
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, command, others = super().resolve_command(ctx, args)
        if command is not None:
            command = loaded(name or "")
        return name, command, others


def _checked(check: Callable[[Any, Any], Any], ctx: Any, value: Any) -> Any:
    """The value of an option as `check` makes it of a text, if there is one."""
    return None if value is None else check(ctx, value)


def loaded(name: str) -> Any:
    """The command of this name, with its options."""
    module, _, function = COMMANDS[name][0].partition(":")
    single = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    single.command(name)(getattr(import_module(f"mbdlft.cli.{module}"), function))
    return typer.main.get_command(single)


app = typer.Typer(
    cls=_Group,
    help="Exact linear models of multibody systems, with their parameters left in.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for _name, (_, _help) in COMMANDS.items():
    app.command(_name, help=_help)(lambda: None)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        typer.echo(f"mbdlft {__version__}")
        raise typer.Exit


def warn(message: object) -> None:
    """Show a warning: one line beside the output."""
    WARNINGS.append(str(message))
    sys.stderr.write(f"mbdlft: warning: {message}\n")


def main() -> None:
    """Run the command line; bad input is one message and exit code 2."""
    # looking for plugins reads the metadata of all installed packages: 4 % of a linearization of the arm
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            # a letter that a terminal does not have is written as \\u
            stream.reconfigure(errors="backslashreplace")
    try:
        try:
            WARNINGS.clear()
            warnings.showwarning = lambda message, *_, **__: warn(message)
            app()
        finally:
            sys.stdout.flush()
    except MbdlftError as error:
        _stop(str(error))
    except MemoryError as error:
        _stop(f"there is too little memory: {error}. Ask for fewer samples, times or values.")
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
