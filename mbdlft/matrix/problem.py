"""The matrix problem: what a user describes who has a matrix instead of a scene, in Python or TOML.

TOML files have the format `mbdlft-matrix/1`; Python to TOML and back gives an equal problem.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self, final

import tomli_w
from pydantic import InstanceOf, ValidationInfo, field_validator, model_validator

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.description import Description, Many, Name, Prose, Quantity, Text
from mbdlft.base.errors import SceneError
from mbdlft.base.expression import BUILTIN_CONSTANTS, names, parse
from mbdlft.base.parameter import Parameter, is_finite
from mbdlft.base.unit import Signal
from mbdlft.multibody.scene import Constant, toml
from mbdlft.multibody.scene.scene import Constants, check_unique, check_value_names


@final
class MatrixProblem(Description):
    """A matrix whose entries are rational in parameters.

    Parameters
    ----------
    name : str
    description : str, optional
    constants : mapping of names to numbers, or to `Constant` with a unit
    parameters : sequence of `Parameter` and `Angle`
    expressions : mapping of names to expressions, optional
        Shared parts; each may use constants, parameters, and the expressions before it.
    matrix : rows of numbers or expressions
        An angle may stand in ``sin`` and ``cos`` only, alone or in a sum with integer factors.
    states : number or names, optional
        How many there are; the leading part of this size is A, and the matrix is [A B ; C D].
    inputs, outputs : sequence of str, optional
        Names for the other columns and rows; u0, u1, ... and y0, y1, ... by default.

    Nothing is converted: a name is the value in the unit it was declared with.
    """

    name: Name = "matrix"
    description: Prose = ""
    constants: Constants = {}
    parameters: Many[InstanceOf[Parameter]] = ()
    expressions: dict[Text, Quantity] = {}
    matrix: Many[Many[Quantity]]
    states: Many[Name] = ()
    inputs: Many[Name] | None = None
    outputs: Many[Name] | None = None

    @classmethod
    def where(cls, fields: Mapping[str, Any]) -> str:
        return f"matrix {fields.get('name', 'matrix')!r}"

    @field_validator("expressions", mode="before")
    @classmethod
    def _expressions_are_quantities(cls, expressions: Any) -> Any:
        for name, value in expressions.items() if isinstance(expressions, Mapping) else ():
            check_quantity(f"expression {name!r}", value)
        return expressions

    @field_validator("matrix", mode="before")
    @classmethod
    def _matrix_has_rows_of_one_length(cls, matrix: Any) -> Any:
        rows = matrix.tolist() if hasattr(matrix, "tolist") else matrix
        if not _is_sequence(rows) or not all(_is_sequence(row) for row in rows):
            raise SceneError(f"expected rows of numbers or expressions, got {matrix!r}.")
        if not rows or not rows[0]:
            raise SceneError("the matrix is empty. Give it at least one row and one column.")
        for i, row in enumerate(rows):
            if len(row) != len(rows[0]):
                raise SceneError(
                    f"row {i} has {len(row)} entries, row 0 has {len(rows[0])}. All rows need one length."
                )
            for j, entry in enumerate(row):
                check_quantity(f"entry ({i}, {j})", entry)
        return rows

    @field_validator("states", mode="before")
    @classmethod
    def _count_of_states_is_names(cls, states: Any, info: ValidationInfo) -> Any:
        if _is_sequence(states):
            return states
        if isinstance(states, bool) or not isinstance(states, int) or states < 0:
            raise SceneError(f"states: expected a number of at least 0, or names, got {states!r}.")
        matrix = info.data.get("matrix")  # without it there is an error already
        if matrix is None:
            return ()
        _check_states(states, matrix)
        return tuple(f"x{k}" for k in range(states))

    @model_validator(mode="after")
    def _names_and_sizes_fit(self) -> Self:
        declared = [p.name for p in self.parameters] + list(self.constants) + list(self.expressions)
        check_value_names("parameter, constant or expression", declared)
        rows, columns = self.shape
        _check_states(len(self.states), self.matrix)
        for what, labels, size in (
            ("inputs", self.inputs, columns - len(self.states)),
            ("outputs", self.outputs, rows - len(self.states)),
        ):
            if labels is not None and len(labels) != size:
                raise SceneError(
                    f"{what}: expected {size} names, one for each "
                    f"{'column' if what == 'inputs' else 'row'} beside the states, got {len(labels)}."
                )
            check_unique(what[:-1], labels or ())
        check_unique("state", self.states)
        return self

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return len(self.matrix), len(self.matrix[0])

    def signals(self) -> tuple[tuple[Signal, ...], tuple[Signal, ...], tuple[Signal, ...]]:
        """States, inputs and outputs; their units are not known and are given as 1."""
        rows, columns = self.shape
        n = len(self.states)
        inputs = self.inputs or tuple(f"u{k}" for k in range(columns - n))
        outputs = self.outputs or tuple(f"y{k}" for k in range(rows - n))
        return _signals(self.states), _signals(inputs), _signals(outputs)

    def constant_values(self) -> dict[str, float]:
        """Constants as declared, with the built-in ones."""
        declared = {
            name: value.value if isinstance(value, Constant) else value
            for name, value in self.constants.items()
        }
        return {**BUILTIN_CONSTANTS, **declared}


def unused_names(problem: MatrixProblem) -> tuple[str, ...]:
    """Parameters, constants and expressions that no text uses."""
    sources = [*problem.expressions.values(), *(entry for row in problem.matrix for entry in row)]
    used = {name for source in sources for name in names(parse(source))}
    declared = (*(p.name for p in problem.parameters), *problem.constants, *problem.expressions)
    return tuple(name for name in declared if name not in used)


def check_quantity(place: str, value: Any) -> None:
    """Raise a SceneError unless a value is a finite number or a text."""
    if not (is_finite(value) or (isinstance(value, str) and value)):
        raise SceneError(f"{place}: expected a finite number or an expression, got {value!r}.")


def _check_states(count: int, matrix: Sequence[Sequence[Any]]) -> None:
    rows, columns = len(matrix), len(matrix[0])
    if count > min(rows, columns):
        raise SceneError(
            f"{count} states do not fit into a matrix of {rows} rows and {columns} columns; the leading "
            "part of that size is A."
        )


def _is_sequence(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _signals(names: Sequence[str]) -> tuple[Signal, ...]:
    return tuple(Signal(name, "1") for name in names)


FORMAT = "mbdlft-matrix/1"


@arguments_checked
def load_matrix(path: str | Path) -> MatrixProblem:
    """Matrix problem of the TOML file at `path`."""
    return toml.read_file(path, matrix_from_toml)


def matrix_from_toml(text: str) -> MatrixProblem:
    """Matrix problem of a TOML text."""
    return toml.read_table(text, _problem)


@arguments_checked
def matrix_to_toml(problem: MatrixProblem) -> str:
    """TOML text of a matrix problem; `matrix_from_toml` gives an equal problem back."""
    table: dict[str, Any] = {"format": FORMAT, "name": problem.name}
    if problem.description:
        table["description"] = problem.description
    for key in ("states", "inputs", "outputs"):
        if getattr(problem, key):
            table[key] = list(getattr(problem, key))
    table["matrix"] = [list(row) for row in problem.matrix]
    table |= toml.values_table(problem.constants, problem.parameters)
    if problem.expressions:
        table["expressions"] = dict(problem.expressions)
    return tomli_w.dumps(table)


def _problem(table: dict[str, Any]) -> MatrixProblem:
    toml.check_keys(table, FORMAT, ("format", *MatrixProblem.model_fields))
    values = {"constants": toml.read_constants(table), "parameters": toml.read_parameters(table)}
    return MatrixProblem(**{key: table[key] for key in table if key != "format"} | values)
