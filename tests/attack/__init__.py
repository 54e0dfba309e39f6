"""Attacks: inputs that are damaged, hostile, absurd, or of a known answer, drawn from a seed.

Each file is one class of attacks with a function ``attack(seed, folder) -> str``: it draws one input,
gives it to the package, and returns a word for what came of it, such as ``refused``. An answer that is
wrong, or an error that is not one of the package, is an exception. `CLASSES` lists them; a new class is
one file and one line there.

    python -m tests.attack [--minutes N] [--only archives,urdf] [--seed K] [--count N]
"""

# name of the class (its file has underscores), and how many seeds `make test` runs
CLASSES = {
    "archives": 20,
    "matrix-files": 2,
    "urdf": 60,
    "robot-formats": 20,
    "scenes": 10,
    "kills": 3,
    "sweeps": 1,
    "writers": 1,
    "matrices": 6,
    "expressions": 40,
    "native": 2,
    "programs": 8,
    "cores": 1,
    "analyses": 9,
    "equations": 2,
    "claims": 1,
    "norms": 2,
}
SECONDS = 20.0  # of the clock that one attack may take
