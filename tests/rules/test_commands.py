"""The command line loads a command's module when the command is called, and its table says the truth."""

import os
import subprocess
import sys

import pytest

from mbdlft.cli.commands import COMMANDS, loaded

PROGRAM = """
import sys
from mbdlft.cli.commands import main
for arguments in {lines}:
    sys.argv = ["mbdlft", *arguments]
    try:
        main()
    except SystemExit as end:
        assert not end.code, (arguments, end.code)
print(*sorted({{name.partition(".")[0] for name in sys.modules}}))
"""


def imported(*lines: tuple[str, ...], **variables: str) -> set[str]:
    """Packages that are imported when a process has run command lines."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(lines=lines)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **variables},
    )
    return set(done.stdout.splitlines()[-1].split())


COMPLETION = {"_MBDLFT_COMPLETE": "complete_bash", "COMP_WORDS": "mbdlft l", "COMP_CWORD": "1"}


@pytest.mark.parametrize(
    ("arguments", "variables"),
    [(("--version",), {}), (("--help",), {}), ((), COMPLETION)],
    ids=["version", "help", "completion"],
)
def test_the_command_line_starts_without_what_it_does_not_need(
    arguments: tuple[str, ...], variables: dict[str, str]
) -> None:
    names = imported(arguments, **variables)
    assert "mbdlft" in names
    assert not names & {"casadi", "numpy", "pydantic", "rich", "scipy"}


def test_help_of_a_command_waits_for_no_equations() -> None:
    """One command of each module."""
    names = {place.partition(":")[0]: name for name, (place, _) in COMMANDS.items()}.values()
    assert not imported(*[(name, "--help") for name in names]) & {
        "casadi",
        "flint",
        "matplotlib",
        "scipy",
    }


@pytest.mark.parametrize("name", COMMANDS)
def test_the_table_has_the_first_line_of_each_command(name: str) -> None:
    assert loaded(name).help.splitlines()[0] == COMMANDS[name][1]
    assert loaded(name).name == name
