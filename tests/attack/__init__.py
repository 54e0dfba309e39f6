"""Attacks: inputs that are damaged, hostile, absurd, or of a known answer, drawn from a seed.

Each file is one class of attacks with a function ``attack(seed, folder) -> str``: it draws one input,
gives it to the package, and returns a word for what came of it, such as ``refused``. An answer that is
wrong, or an error that is not one of the package, is an exception. `CLASSES` lists them; a new class is
one file and one line there.

    python -m tests.attack [--minutes N] [--only archives,urdf] [--seed K] [--count N]
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

# name of the class (its file has underscores), and the seeds of `make test`: some tenths of a second;
# of claims tests/laws/test_claims.py has one change after another
# and tests/laws/test_sparse.py compares sparse models with dense ones
CLASSES: dict[str, Sequence[int]] = {
    "archives": range(2),
    "matrix-files": (1, 3),
    "urdf": range(20),
    "robot-formats": range(4),
    "scenes": range(4),
    "kills": (0,),
    "sweeps": (1,),
    "writers": (1,),
    "matrices": (1, 8, 12, 19, 22),
    "expressions": range(30),
    "native": (8,),
    "programs": range(3),
    "cores": (0,),
    "analyses": (2,),
    "equations": (0,),
    "claims": (),
    "proofs": (66,),
    "norms": (0, 2, 7, 15, 287),
    "frames": (2, 55, 79, 880006),
    "loops": (3,),
    "switches": range(4),
    "mechanisms": (0,),
    "sparse": (),
    "couplings": (0,),
    "contacts": (3,),
    "motions": (0,),
    "empty": (14, 31, 35, 45),
    "tunings": (20,),
    "syntheses": (976003, 976012, 976029, 977193),
    "accelerations": (0, 5),
    "certificates": (3,),
    "reductions": (0, 1, 2, 4, 5, 9),
    "reasons": (3, 5, 7, 9, 11, 56, 68, 88, 132),
}
SECONDS = 20.0  # of the clock that one attack may take


def process_of(module: str, **environment: str) -> "subprocess.Popen[str]":
    """A process that runs a module, with one thread, and is talked to in lines."""
    root = Path(__file__).parents[2]
    return subprocess.Popen(
        [sys.executable, "-m", module],
        cwd=root,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, **environment, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(root)},
    )
