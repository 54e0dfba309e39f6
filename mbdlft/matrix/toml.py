"""Matrix problems as TOML files: `mbdlft-matrix/1`. Python to TOML and back gives an equal problem."""

from pathlib import Path
from typing import Any

import tomli_w

from mbdlft.matrix.problem import MatrixProblem
from mbdlft.multibody.scene.toml import (
    check_keys,
    read_constants,
    read_file,
    read_parameters,
    read_table,
    values_table,
)

FORMAT = "mbdlft-matrix/1"
_PLAIN = ("name", "description", "expressions", "matrix", "states", "inputs", "outputs")
_TOP = ("format", *_PLAIN, "constants", "parameters")


def load_matrix(path: str | Path) -> MatrixProblem:
    """Matrix problem of a TOML file.

    Parameters
    ----------
    path : file

    Raises
    ------
    SceneError
        The file cannot be read or is not a matrix problem; the message names the file.
    """
    return read_file(path, matrix_from_toml)


def matrix_from_toml(text: str) -> MatrixProblem:
    """Matrix problem of a TOML text.

    Raises
    ------
    SceneError
        The text is not TOML (with the line), or not a matrix problem.
    """
    return read_table(text, _problem)


def matrix_to_toml(problem: MatrixProblem) -> str:
    """TOML text of a matrix problem; `matrix_from_toml` gives an equal problem back."""
    table: dict[str, Any] = {"format": FORMAT, "name": problem.name}
    if problem.description:
        table["description"] = problem.description
    for key in ("states", "inputs", "outputs"):
        if getattr(problem, key):
            table[key] = list(getattr(problem, key))
    table["matrix"] = [list(row) for row in problem.matrix]
    table |= values_table(problem.constants, problem.parameters)
    if problem.expressions:
        table["expressions"] = dict(problem.expressions)
    return tomli_w.dumps(table)


def _problem(table: dict[str, Any]) -> MatrixProblem:
    check_keys(table, FORMAT, _TOP)
    return MatrixProblem(
        **{key: table[key] for key in _PLAIN if key in table},
        constants=read_constants(table),
        parameters=read_parameters(table),
    )
