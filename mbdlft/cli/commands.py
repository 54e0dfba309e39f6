"""The command line: what makes, shows, analyzes and verifies models."""

import contextlib
import os
import sys
import warnings
from io import TextIOWrapper
from typing import Annotated, NoReturn

import typer

from mbdlft import __version__
from mbdlft.base.errors import MbdlftError, shortened
from mbdlft.cli.bounds import margin, verify, wcgain, worst
from mbdlft.cli.files import export, report, sweep, view
from mbdlft.cli.models import check, linearize, realize
from mbdlft.cli.output import WARNINGS, say, warn
from mbdlft.cli.responses import poles, response
from mbdlft.cli.scenes import body, import_robot, schema, trim
from mbdlft.cli.summary import show

app = typer.Typer(
    help="Exact linear models of multibody systems, with their parameters left in.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
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
app.command()(trim)
app.command()(realize)
app.command()(show)


def main() -> None:
    """Run the command line; bad input is one message and exit code 2."""
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
        say(f"mbdlft {__version__}")
        raise typer.Exit
