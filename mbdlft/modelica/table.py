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

from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.multibody.scene.toml import check_keys, read_file, read_table

FORMAT = "mbdlft-modelica/1"
_MOST_ORDER = 10  # of a Pade approximation
_TOP = ("format", "model", "check_units", "parameters", "values", "linearize", "trim")
_LISTS = {"linearize": ("outputs", "states"), "trim": ("free", "moving")}
_BESIDE = {"linearize": ("delay",), "trim": ("at", "fit", "point")}
POINTS = ("equilibrium", "start")


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


def load_modelica_table(path: str | Path) -> ModelicaTable:
    """The table of the TOML file at `path`.

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
    sections = {key: table.get(key, {}) for key in _TOP[3:]}
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
    for key, kind, word in (("model", str, "a text"), ("check_units", bool, "true or false")):
        if key in table and not isinstance(table[key], kind):
            raise SceneError(f"{key}: expected {word}, got {table[key]!r}.")
    return ModelicaTable(
        table.get("model"),
        sections["parameters"],
        sections["values"],
        **_lists(sections),
        at=_at(sections["trim"].get("at", {})),
        fit=_fit(sections["trim"].get("fit")),
        point=point_of(sections["trim"].get("point", POINTS[0]), "trim: point"),
        delay=_delay(sections["linearize"].get("delay")),
        check_units=table.get("check_units", True),
    )


def _lists(sections: Mapping[str, Mapping[str, Any]]) -> dict[str, tuple[str, ...]]:
    lists = {}
    for section, keys in _LISTS.items():
        known = (*keys, *_BESIDE[section])
        for key, names in sections[section].items():
            if key not in known:
                raise SceneError(f"{section}: " + unknown_name("key", key, known))
            if key in _BESIDE[section]:
                continue
            if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
                raise SceneError(f"{section}: {key}: expected a list of names, got {names!r}.")
            lists[key] = tuple(names)
    return lists


def _delay(entry: Any) -> int | None:
    is_order = isinstance(entry, int) and not isinstance(entry, bool) and 1 <= entry <= _MOST_ORDER
    if entry is not None and not is_order:
        raise SceneError(f"linearize: delay: expected an order from 1 to {_MOST_ORDER}, got {entry!r}.")
    return None if entry is None else int(entry)


def point_of(entry: Any, where: str) -> str:
    """The operating point that is asked for; `where` is for messages."""
    if entry not in POINTS:
        raise SceneError(f"{where}: expected {' or '.join(POINTS)}, got {entry!r}.")
    return str(entry)


def _fit(entry: Any) -> float | None:
    is_number = isinstance(entry, int | float) and not isinstance(entry, bool)
    if entry is not None and not (is_number and 0.0 < entry < 1.0):
        raise SceneError(f"trim: fit: expected a tolerance between 0 and 1, got {entry!r}.")
    return None if entry is None else float(entry)


def _at(entry: Any) -> Mapping[str, float | str]:
    """Values of the equilibrium by name: numbers, or names of parameters."""
    if not isinstance(entry, dict):
        raise SceneError(f"trim: at: expected a table of values by name, got {entry!r}.")
    for name, value in entry.items():
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise SceneError(
                f"trim: at: {name!r}: expected a number or the name of a parameter, got {value!r}."
            )
    return entry
