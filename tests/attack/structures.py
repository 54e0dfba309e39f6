"""Changes of a TOML table as a tree: numbers at extremes, parts gone, doubled, exchanged or renamed."""

import json
from copy import deepcopy
from typing import Any

import numpy as np

Path = tuple[str | int, ...]
EXTREMES = (0, -1, 1e155, 1e-155, 1e300, 1e-300, 5e-324, 1e308, 1e16, -1e-16, 90.0, 180.0, 360.0)
ODD = (True, "", [], {}, [[]], {"a": {}}, "x", "1/0", "0*m", float("nan"), float("inf"), [1] * 2000)
WRAPPED = (
    "({x})*{y}", "({x}) - ({x})", "({x}) + 1e-13*({x})", "1/({x})", "({x})^2/({x})", "-({x})",
    "(({x})*3 - ({x})*2)", "sqrt(2)*({x})/sqrt(2)", "({x})*(1 + {y}) - {y}*({x})", "({x})/3*3",
)  # fmt: skip
KINDS = (
    "rigid", "point_mass", "beam", "flexible", "revolute", "prismatic", "fixed", "universal", "planar",
    "cylindrical", "spherical", "free", "spring", "force", "torque", "buoyancy", "gyro", "joint_wrench",
)  # fmt: skip


def restructured(table: dict[str, Any], random: np.random.Generator) -> dict[str, Any]:
    """A table with one to three places changed."""
    table = deepcopy(table)
    for _ in range(int(random.choice([1, 1, 2, 3]))):
        places = list(_paths(table, ()))
        if not places:
            break
        _change(table, places, random)
    return table


def _change(table: dict[str, Any], places: list[Path], random: np.random.Generator) -> None:
    """Change one place of a table."""
    leaves = [path for path in places if not isinstance(_at(table, path), dict | list)]
    kind = int(random.integers(10))
    path = places[int(random.integers(len(places)))]
    if kind < 6 and leaves:
        path = leaves[int(random.integers(len(leaves)))]
    owner, key = _at(table, path[:-1]), path[-1]
    value = owner[key]
    match kind:
        case 0 | 1:
            owner[key] = _number(value, random)
        case 2 | 3 if isinstance(value, str | int | float):
            text = WRAPPED[int(random.integers(len(WRAPPED)))]
            owner[key] = text.replace("{x}", str(value)).replace("{y}", repr(random.uniform(-2, 2)))
        case 4 if path[-1] == "kind":
            owner[key] = KINDS[int(random.integers(len(KINDS)))]
        case 4 | 5:
            other = leaves[int(random.integers(len(leaves)))]
            owner[key] = deepcopy(_at(table, other))
        case 6:
            del owner[key]
        case 7 if isinstance(owner, dict) and isinstance(value, dict):
            owner[f"{key}_2"] = deepcopy(value)
        case 8:
            other = places[int(random.integers(len(places)))]
            owner[key] = deepcopy(_at(table, other))
        case _:
            owner[key] = deepcopy(ODD[int(random.integers(len(ODD)))])


def _number(value: Any, random: np.random.Generator) -> Any:
    """An extreme, or the number in another size or with another sign."""
    if random.random() < 0.4 or isinstance(value, str | bool):
        return EXTREMES[int(random.integers(len(EXTREMES)))]
    power = float(random.choice([-12, -6, -3, -1, 1, 3, 6, 12]))
    return float(value) * float(random.choice([-1.0, 1.0, 1.0])) * 10.0**power


def _paths(item: Any, path: Path) -> Any:
    """Paths of all items below one."""
    keys = list(item) if isinstance(item, dict) else range(len(item))
    for key in keys:
        yield (*path, key)
        if isinstance(item[key], dict | list):
            yield from _paths(item[key], (*path, key))


def _at(item: Any, path: Path) -> Any:
    for key in path:
        item = item[key]
    return item


def as_toml(table: dict[str, Any]) -> str:
    """The text of a table: a line for each key."""
    return "".join(f"{json.dumps(key)} = {_text(value)}\n" for key, value in table.items())


def _text(value: Any) -> str:
    if isinstance(value, dict):
        inner = ", ".join(f"{json.dumps(key)} = {_text(item)}" for key, item in value.items())
        return f"{{{inner}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    return repr(value) if isinstance(value, float) else json.dumps(value)
