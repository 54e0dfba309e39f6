"""Programs in processes of their own, where packages may be missing."""

import os
import subprocess
import sys
from pathlib import Path

_WITHOUT = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ImportError(f"{{name}} is blocked")

sys.meta_path.insert(0, Blocked())
"""


def printed(program: str, *arguments: object, without: tuple[str, ...] = (), **variables: str) -> str:
    """What a program of Python prints that ends well and warns of nothing, without these packages."""
    program = _WITHOUT.format(names=without) + program if without else program
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program, *map(str, arguments)],
        cwd=Path(__file__).parents[1], env={**os.environ, **variables},
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return done.stdout
