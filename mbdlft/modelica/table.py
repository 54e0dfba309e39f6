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
    outputs = ["load.phi", "load.w"]
    states = ["load.phi", "load.w", "motor.i"]
    delay = 3

    [trim]
    at = { "load.phi" = 0.3 }
    free = ["voltage"]
    moving = []
    fit = 1e-6
    point = "equilibrium"
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import check_known
from mbdlft.multibody.scene.toml import Kind, check_keys, check_value, read_file, read_table

FORMAT = "mbdlft-modelica/1"
_MOST_ORDER = 10  # of a Pade approximation
POINTS = ("equilibrium", "start")
_NUMBER: Kind = (lambda x: isinstance(x, int | float) and not isinstance(x, bool), "a number")
_TEXT: Kind = (lambda x: isinstance(x, str), "a text")
_AT: Kind = (lambda x: _NUMBER[0](x) or _TEXT[0](x), "a number or the name of a parameter")
_TABLE: Kind = (lambda x: isinstance(x, dict), "a table")
_NAMES: Kind = (lambda x: isinstance(x, list) and all(map(_TEXT[0], x)), "a list of names")
_POINT: Kind = (lambda x: x in POINTS, " or ".join(POINTS))
_STAYS: Kind = (
    lambda x: isinstance(x, dict) or x is False,
    "a table such as { low = 1, high = 2 }, or false for a number",
)
_TOP: Mapping[str, Kind] = {
    "format": _TEXT,
    "model": _TEXT,
    "check_units": (lambda x: isinstance(x, bool), "true or false"),
    **dict.fromkeys(("parameters", "values", "linearize", "trim"), _TABLE),
}
_SECTIONS: Mapping[str, Mapping[str, Kind]] = {
    "linearize": {
        "outputs": _NAMES,
        "states": _NAMES,
        "delay": (
            lambda x: type(x) is int and 1 <= x <= _MOST_ORDER,
            f"an order from 1 to {_MOST_ORDER}",
        ),
    },
    "trim": {
        "free": _NAMES,
        "moving": _NAMES,
        "at": (_TABLE[0], "a table of values by name"),
        "fit": (lambda x: _NUMBER[0](x) and 0.0 < x < 1.0, "a tolerance between 0 and 1"),
        "point": _POINT,
    },
}


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
    outputs : tuple of str, or None
        Outputs of the linear model, in this order; None: those that the model declares.
    states : tuple of str
        Variables that are to be states, where there is a choice.
    delay : int or None
        The order of the Pade approximations that stand for delays; None: delays are refused.
    at, free, moving
        As in `mbdlft.dae.equilibria`: what the equilibrium is at, inputs that it gives, what may grow.
    fit : float or None
        As in `mbdlft.dae.equilibria`: the tolerance of fits, where the equilibrium is not rational.
    point : {"equilibrium", "start"}
        The operating point; at the start, rates are those that the equations give there.
    check_units : bool
        Whether units that do not fit are an error.
    """

    model: str | None = None
    parameters: Mapping[str, Mapping[str, Any] | bool] = field(
        default_factory=lambda: MappingProxyType({})
    )
    values: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    outputs: tuple[str, ...] | None = None
    states: tuple[str, ...] = ()
    delay: int | None = None
    at: Mapping[str, float | str] = field(default_factory=lambda: MappingProxyType({}))
    free: tuple[str, ...] = ()
    moving: tuple[str, ...] = ()
    fit: float | None = None
    point: str = "equilibrium"
    check_units: bool = True


@arguments_checked
def load_modelica_table(path: str | Path) -> ModelicaTable:
    """The table of the TOML file at `path`."""
    return read_file(path, modelica_table_from_toml)


def modelica_table_from_toml(text: str) -> ModelicaTable:
    """The table of a TOML text."""
    return read_table(text, _table)


def _table(table: dict[str, Any]) -> ModelicaTable:
    check_keys(table, FORMAT, _TOP)
    for key in table:
        check_value(key, table[key], _TOP[key])
    sections = {key: table.get(key, {}) for key in ("parameters", "values")}
    for name, entry in sections["parameters"].items():
        check_value(f"parameter {name!r}", entry, _STAYS)
    for name, value in sections["values"].items():
        check_value(f"values: {name!r}", value, _NUMBER)
    entries: dict[str, Any] = {}
    for section, kinds in _SECTIONS.items():
        given = table.get(section, {})
        check_known("key", given, kinds, section)
        for key, value in given.items():
            check_value(f"{section}: {key}", value, kinds[key])
            entries[key] = tuple(value) if isinstance(value, list) else value
    for name, value in entries.get("at", {}).items():
        check_value(f"trim: at: {name!r}", value, _AT)
    plain = {key: table[key] for key in ("model", "check_units") if key in table}
    return ModelicaTable(**plain, **sections, **entries)


def point_of(entry: Any, where: str) -> str:
    """The operating point that is asked for; `where` is for messages."""
    check_value(where, entry, _POINT)
    return str(entry)
