"""The table beside a model: which parameters stay, values, inputs and outputs; a TOML file.

::

    format = "mbdlft-modelica/1"
    model = "Drives.Servo"

    [parameters]
    "load.J" = { low = 0.8, high = 1.4 }
    "motor.R" = { percent = 20, role = "design" }
    efficiency = false

    [values]
    "motor.k" = 0.21

    [linearize]
    inputs = ["voltage"]
    outputs = ["load.phi", "load.w"]
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.multibody.scene.toml import check_keys, read_file, read_table

FORMAT = "mbdlft-modelica/1"
_TOP = ("format", "model", "parameters", "values", "linearize")
_LINEARIZE = ("inputs", "outputs")


@dataclass(frozen=True, slots=True)
class ModelicaTable:
    """What a user says beside a Modelica model.

    Attributes
    ----------
    model : str or None
        Which model of a file with several.
    parameters : mapping of names of the model to keys of `Parameter`
        Those that stay; what is not given is that of the declaration. False: it stays a number.
    values : mapping of names to numbers
        These replace values of parameters.
    inputs, outputs : tuple of str, or None
        Signals of the linear model, in this order; None: those that the model declares.
    """

    model: str | None = None
    parameters: Mapping[str, Mapping[str, Any] | bool] = field(
        default_factory=lambda: MappingProxyType({})
    )
    values: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    inputs: tuple[str, ...] | None = None
    outputs: tuple[str, ...] | None = None


def load_modelica_table(path: str | Path) -> ModelicaTable:
    """The table of a TOML file.

    Parameters
    ----------
    path : file

    Raises
    ------
    SceneError
        The file cannot be read or is not such a table; the message names the file.
    """
    return read_file(path, modelica_table_from_toml)


def modelica_table_from_toml(text: str) -> ModelicaTable:
    """The table of a TOML text.

    Raises
    ------
    SceneError
        The text is not TOML, or not such a table.
    """
    return read_table(text, _table)


def _table(table: dict[str, Any]) -> ModelicaTable:
    check_keys(table, FORMAT, _TOP)
    sections = {key: table.get(key, {}) for key in _TOP[2:]}
    for key, section in sections.items():
        if not isinstance(section, dict):
            raise SceneError(f"{key}: expected a table, got {section!r}.")
    for name, entry in sections["parameters"].items():
        if not isinstance(entry, dict) and entry is not False:
            raise SceneError(
                f"parameter {name!r}: expected a table such as {{ low = 1, high = 2 }}, or false for a "
                f"number, got {entry!r}."
            )
    for name, value in sections["values"].items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise SceneError(f"values: {name!r}: expected a number, got {value!r}.")
    for key, names in sections["linearize"].items():
        if key not in _LINEARIZE:
            raise SceneError("linearize: " + unknown_name("key", key, _LINEARIZE))
        if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
            raise SceneError(f"linearize: {key}: expected a list of signal names, got {names!r}.")
    if not isinstance(table.get("model", ""), str):
        raise SceneError(f"model: expected a text, got {table['model']!r}.")
    chosen = {key: tuple(names) for key, names in sections["linearize"].items()}
    return ModelicaTable(table.get("model"), sections["parameters"], sections["values"], **chosen)
