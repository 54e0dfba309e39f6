"""Importing the package loads nothing heavy: parts with large dependencies come when they are used."""

import subprocess
import sys

import mbdlft

HEAVY = {"casadi", "control", "distributed", "matplotlib", "pydantic", "rich", "scipy", "typer"}
PROGRAM = """
import sys
import mbdlft
{use}
print(*sorted({{name.partition(".")[0] for name in sys.modules}}))
"""


def loaded(use: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(use=use)], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_import_loads_nothing_heavy() -> None:
    found = loaded("")
    assert "mbdlft" in found
    assert not found & HEAVY


def test_first_use_loads_what_it_needs() -> None:
    """The same look finds what is loaded, so the test above can fail."""
    assert {"casadi", "pydantic"} <= loaded("mbdlft.Scene")
    assert callable(mbdlft.to_lft)
