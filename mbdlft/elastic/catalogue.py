"""Flexible bodies of scenes: of a modal model, of matrices, or of a file of the catalogue.

A catalogue file, of the format `mbdlft-body/1`, is a description beside the data of one body. A scene
file does not refer to the catalogue: it contains the table of the body, which the command `mbdlft body`
prints. So a scene file can be read without any other file.
"""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import (
    MbdlftWarning,
    SceneError,
    StructureError,
    check_known,
    naming,
    unknown_name,
)
from mbdlft.elastic.files import load_matrices, load_nastran
from mbdlft.elastic.modal import ModalModel, modal_model
from mbdlft.elastic.nodes import Interface, Nodes
from mbdlft.elastic.partition import FiniteElements, to_si
from mbdlft.multibody.body import Body, FlexibleBody, Inertia, Mode
from mbdlft.multibody.scene.toml import read_body, read_file, read_table

FORMAT = "mbdlft-body/1"
LIMITS = ("modes", "frequency", "effective_mass")
_CHOICES = (*LIMITS, "method", "damping", "prestress")
_NASTRAN = ("bulk", "mass_matrix", "stiffness_matrix")
_UNITS = ("length_unit", "mass_unit")
_TEXTS = ("format", "description", "source")
_DATA = ("data", "parent", "ports", *_CHOICES, *_NASTRAN, *_UNITS)


@arguments_checked
def flexible_body(
    name: str,
    mass_matrix: Any,
    stiffness_matrix: Any,
    nodes: Nodes,
    parent: Any,
    ports: Mapping[str, Any],
    *,
    method: str = "hurty",
    modes: int | None = None,
    frequency: float | None = None,
    effective_mass: float | None = None,
    damping: float | str | Sequence[float | str] = 0.0,
    prestress: str | None = None,
) -> FlexibleBody:
    """Make a flexible body of a scene from the matrices of a finite-element model.

    Parameters
    ----------
    name : str
    mass_matrix, stiffness_matrix, nodes, parent, ports, method, modes, frequency, effective_mass
        As in `modal_model`.
    damping : damping ratio [1], a number or an expression, of all modes; or a sequence with one for
        each mode of the body
    prestress : ``neglected`` or None, as for every elastic body
    """
    choice: dict[str, Any] = {"modes": modes, "frequency": frequency, "effective_mass": effective_mass}
    model = modal_model(mass_matrix, stiffness_matrix, nodes, parent, ports, method=method, **choice)
    return modal_body(name, model, damping=damping, prestress=prestress)


@arguments_checked
def modal_body(
    name: str,
    model: ModalModel,
    *,
    damping: float | str | Sequence[float | str] = 0.0,
    prestress: str | None = None,
) -> FlexibleBody:
    """Make a flexible body of a scene from a modal model.

    Parameters
    ----------
    name : str
    model : ModalModel
    damping, prestress : as in `flexible_body`

    Warns
    -----
    MbdlftWarning
        A port that carries a mass would make frequencies wrong by more than a percent: `lacking` of the
        model says which.
    """
    if lacking := model.lacking():
        warnings.warn(f"body {name!r}, {lacking}", MbdlftWarning, stacklevel=2)
    count = len(model.frequencies)
    ratios = [damping] * count if isinstance(damping, str | int | float) else list(damping)
    if len(ratios) != count:
        raise StructureError(
            f"body {name!r}: damping: expected one ratio or {count}, one for each mode, got "
            f"{len(ratios)}."
        )
    modes = [
        Mode(
            frequency=float(model.frequencies[k]),
            damping=float(ratio) if isinstance(ratio, int) else ratio,
            participation=tuple(map(float, model.participation[:, k])),
            shapes={port: tuple(map(float, shape[:, k])) for port, shape in model.shapes.items()},
        )
        for k, ratio in enumerate(ratios)
    ]
    rigid = model.rigid
    entries = {
        f"{'xyz'[i]}{'xyz'[j]}": float(rigid.inertia[i, j])
        for i in range(3)
        for j in range(i, 3)
        if not np.isnan(rigid.inertia[i, j])
    }
    return FlexibleBody(
        name=name,
        mass=rigid.mass,
        center_of_mass=tuple(map(float, rigid.center)),
        inertia=Inertia(**entries, about="origin"),
        ports={port: tuple(map(float, position)) for port, position in model.ports.items()},
        modes=tuple(modes),
        prestress=prestress,
    )


@arguments_checked
def load_body(path: str | Path, name: str | None = None, **choices: Any) -> Body:
    """Load the body of a catalogue file, ready for a scene.

    Parameters
    ----------
    path : TOML file with the format `mbdlft-body/1`
    name : name of the body in the scene; by default that of the file
    choices : method, modes, frequency, effective_mass, damping, prestress
        These replace the entries of the file, if the file describes a body by matrices.
    """
    file = Path(path)
    table = body_table(file)
    called = name or file.stem
    if "body" in table:
        if choices:
            key = next(iter(choices))
            raise SceneError(f"{file}: {key!r} cannot be chosen: the body has no matrices.")
        with naming(file):
            return read_body(called, table["body"])
    options = _options(file, table, choices)
    kept = {key: options[key] for key in ("damping", "prestress") if key in options}
    return modal_body(called, reduced_body(file, **choices), **kept)


def reduced_body(path: str | Path, **choices: Any) -> ModalModel:
    """Modal model of a catalogue file that describes a body by matrices; arguments as of `load_body`."""
    file = Path(path)
    table = body_table(file)
    if "data" not in table:
        raise SceneError(f"{file}: the body has no matrices ('data').")
    options = _options(file, table, choices)
    reduction = {key: options[key] for key in (*LIMITS, "method") if key in options}
    with naming(file):
        parent = _interface("parent", table["parent"])
        ports = {port: _interface(f"ports.{port}", at) for port, at in table["ports"].items()}
        return modal_model(*_matrices(file.parent, table), parent, ports, **reduction)


def body_table(path: str | Path) -> dict[str, Any]:
    """Entries of a catalogue file; a `SceneError` if a key is missing, unknown or of a wrong type."""
    return read_file(path, lambda text: read_table(text, _checked))


def _checked(table: dict[str, Any]) -> dict[str, Any]:
    """The table itself, if its keys and their types are those of the format."""
    if table.get("format") != FORMAT:
        raise SceneError(f"format: expected {FORMAT!r}, got {table.get('format')!r}.")
    known = (*_TEXTS, *(("body",) if "body" in table else _DATA))
    for key in table:
        if key not in known:
            raise SceneError(unknown_name("key", key, known))
    needed = (*_TEXTS, "body") if "body" in table else (*_TEXTS, "data", "parent", "ports")
    for key in needed:
        if key not in table:
            raise SceneError(f"{key!r} is missing.")
    for key in ("body", "ports"):
        if not isinstance(table.get(key, {}), dict):
            raise SceneError(f"{key}: expected a table, got {table[key]!r}.")
    for key in (*_TEXTS, "data", *_NASTRAN, *_UNITS):
        if key in table and not isinstance(table[key], str):
            raise SceneError(f"{key}: expected a text, got {table[key]!r}.")
    return table


def _options(file: Path, table: Mapping[str, Any], choices: Mapping[str, Any]) -> dict[str, Any]:
    """Entries of the file, replaced by `choices`; a chosen limit replaces every limit of the file."""
    check_known("choice", choices, _CHOICES, str(file))
    options = {key: table[key] for key in _CHOICES if key in table}
    if any(key in choices for key in LIMITS):
        options = {key: value for key, value in options.items() if key not in LIMITS}
    return options | dict(choices)


def _matrices(folder: Path, table: Mapping[str, Any]) -> FiniteElements:
    """Matrices of the files that the table names, in SI units."""
    data = folder / table["data"]
    if "bulk" in table:
        mass, stiffness = table.get("mass_matrix", "MAA"), table.get("stiffness_matrix", "KAA")
        elements = load_nastran(data, folder / table["bulk"], mass=mass, stiffness=stiffness)
    else:
        elements = load_matrices(data)
    if any(unit in table for unit in _UNITS):
        return to_si(elements, table.get("length_unit", "m"), table.get("mass_unit", "kg"))
    return elements


def _interface(what: str, entry: Any) -> Any:
    """An entry `parent` or `ports.NAME`: a node number, a list of them, or a table of nodes and point."""
    if not isinstance(entry, dict):
        return entry
    if set(entry) - {"nodes", "point"} or "nodes" not in entry:
        raise StructureError(f"{what}: expected nodes and, if need be, a point, got {entry!r}.")
    point = entry.get("point")
    return Interface(entry["nodes"], tuple(point) if isinstance(point, list) else point)
