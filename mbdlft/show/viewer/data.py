"""Functions of SX as tapes of straight-line operations that a page can follow without CasADi.

What a page knows of the dynamics: the loads of the equilibrium as a tape, and modes at samples.

Everything that a page shows, as plain data: items, tapes, parameters, coordinates, modes.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import MbdlftError, TrimError, WellPosednessError, unknown_name
from mbdlft.base.parameter import Parameter
from mbdlft.base.samples import corners, random
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.body import GROUND
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.to_problem import choose_signals
from mbdlft.problem.equations import Equations, physical_symbols
from mbdlft.problem.linearization import linearized
from mbdlft.problem.sx.constants import in_doubles
from mbdlft.problem.sx.tapes import steps
from mbdlft.problem.trim import relations_at_rest, trim_efforts, trim_rows
from mbdlft.response.modes import balancing, spectrum
from mbdlft.show.viewer.drawing import Drawing, Item, draw
from mbdlft.show.viewer.looks import robot_looks
from mbdlft.show.viewer.poses import Poses, equilibrium_positions, gaps, poses

# the operations that `interpret` of assets/interpret.js knows, by their place in this list
OPERATIONS = (
    "const", "input", "output", "assign", "add", "sub", "mul", "div", "neg", "sq", "twice", "inv",
    "sqrt", "sin", "cos", "tan", "atan",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Tape:
    """A function (first argument, second argument, ...) as numbers.

    Attributes
    ----------
    steps : four integers for each operation
        Its place in `OPERATIONS`, the register of its result, those of its operands. An input has the
        number of its argument and of its entry, a constant its place in `constants`, an output the
        number of its entry in place of a register.
    constants : floats
    registers, outputs : how many there are
    """

    steps: tuple[int, ...]
    constants: tuple[float, ...]
    registers: int
    outputs: int

    def as_data(self) -> dict[str, object]:
        """The tape as plain data, for JSON."""
        return {
            "steps": list(self.steps),
            "constants": list(self.constants),
            "registers": self.registers,
            "outputs": self.outputs,
        }


def tape_of(function: ca.Function) -> Tape:
    """The tape of a function of SX with one result, which is dense.

    Raises
    ------
    NotImplementedError
        An operation is none of `OPERATIONS`: a kind of joint or body uses one that pages do not know.
    """
    found: list[int] = []
    constants: dict[float, int] = {}
    for operation, target, sources in steps(function):
        if operation not in OPERATIONS:
            raise NotImplementedError(f"the operation {operation!r} of {function.name()!r}")
        code = OPERATIONS.index(operation)
        if operation == "const":
            entry = [constants.setdefault(sources[0], len(constants)), 0]
            found += [code, target, *entry]
        elif operation == "output":
            found += [code, target[1], sources[0], 0]
        else:
            found += [code, target, *_two(sources)]
    return Tape(tuple(found), tuple(constants), int(function.sz_w()), int(function.nnz_out(0)))


def _two(sources: Sequence[int]) -> tuple[int, int]:
    return (sources[0], sources[1] if len(sources) > 1 else 0)


_MOST_CORNERS = 6  # parameters of which all corners are samples
_RANDOM = 24
_MOST_NUMBERS = 120_000  # of all modes together
_MOST_MODES = 40
_OWN = 1e-3  # of a shape at zero: what others do not have
_DIGITS = 5


def chosen_point(parameters: Sequence[Parameter], values: Mapping[str, float]) -> Array:
    """Physical values (n_p,): those by name, in their units, and nominal ones.

    Raises
    ------
    TrimError
        A name is unknown, or a value is outside its range.
    """
    known = {parameter.name: parameter for parameter in parameters}
    for name, value in values.items():
        if name not in known:
            raise TrimError("view: " + unknown_name("parameter", name, known))
        if not known[name].low <= value <= known[name].high:
            raise TrimError(
                f"view: {name} = {value:g} is outside its range [{known[name].low:g}, "
                f"{known[name].high:g}] {known[name].unit}."
            )
    return np.array([float(values.get(p.name, p.nominal)) for p in parameters])


def trim_data(equations: Equations) -> dict[str, Any]:
    """The loads at equilibrium: 0 = offset + slopes unknown, and what is given, as a tape of p.

    The result of the tape is [offset ; slopes by columns ; given]; `rows` of the first two determine
    the `unknown` entries of u.
    """
    e = equations
    symbols = physical_symbols(e.parameters)
    offset, slopes, given = relations_at_rest(e, symbols)
    rows = list(trim_rows(e))
    chosen = ca.vertcat(offset[rows], ca.vec(slopes[rows, :]), given)
    function = ca.Function("trim", [symbols[0]], [ca.densify(in_doubles(ca.densify(chosen)))])
    return {
        "tape": tape_of(function).as_data(),
        "unknown": list(e.unknown),
        "efforts": [{"name": s.name, "unit": s.unit} for s in e.u_signals],
    }


def mode_data(scene: Scene, equations: Equations, chosen: Array) -> list[dict[str, Any]]:
    """Modes at samples of the parameters: the chosen values, nominal, ends and corners of the ranges.

    Returns
    -------
    list of {"point", "modes"}
        `point` are the physical values; each mode has the eigenvalue `real`, `imag` (rad/s) and the
        displacements `shape`: real and imaginary parts by coordinate.

    Raises
    ------
    TrimError, WellPosednessError
        There is no equilibrium, or no linear model, at one of the samples.
    """
    e = equations
    n = e.degrees_of_freedom
    states = list(e.states)
    moving = [k for k, state in enumerate(states) if state < n]
    points = _samples(e.parameters, chosen)
    most = max(1, _MOST_NUMBERS // max(1, 2 * len(moving) * min(len(moving), _MOST_MODES)))
    points = points[:most]
    efforts, _ = trim_efforts(e, points)
    inputs, outputs = choose_signals(scene, e)
    matrices = linearized(e, inputs, outputs, points, efforts)
    A = matrices[:, : len(states), : len(states)]
    return [
        {"point": point.tolist(), "modes": _modes(scene.name, matrix, moving)}
        for point, matrix in zip(points, A, strict=True)
    ]


def _samples(parameters: tuple[Parameter, ...], chosen: Array) -> Array:
    """Points (N, n_p), the chosen one first, then nominal, the ends of each range, corners, others."""
    nominal = np.array([p.nominal for p in parameters])
    points = [chosen, nominal]
    for k, p in enumerate(parameters):
        for end in (p.low, p.high):
            points.append(nominal.copy())
            points[-1][k] = end
    if parameters:
        if len(parameters) <= _MOST_CORNERS:
            found = corners(parameters)
            points += list(np.stack([found[p.name] for p in parameters], axis=1))
        inside = random(parameters, _RANDOM, 0)
        points += list(np.stack([inside[p.name] for p in parameters], axis=1))
    unique = {tuple(point): point for point in points}
    return np.array(list(unique.values())).reshape(len(unique), len(parameters))


def _modes(name: str, A: Array, moving: Sequence[int]) -> list[dict[str, Any]]:
    """Modes of one matrix (nx, nx), slowest first; one of each pair, with displacements only.

    What rounding has left of real parts on the axis, and of zero, is zero. Of the poles at zero there are
    as many as have shapes of their own: a body that moves freely has a double pole for each.
    """
    import scipy.linalg  # here because it is slow to import

    with np.errstate(all="ignore"):
        scale = balancing(A)
        scaled = A * (scale / scale[:, None])
    if not np.isfinite(scaled).all():
        raise WellPosednessError(
            f"scene {name!r}: an entry of the linear model is not finite at a sample, so there are no "
            "modes. Masses, lengths or stiffnesses are of very different size."
        )
    seen = spectrum(scaled)
    values, vectors = scipy.linalg.eig(scaled, check_finite=False)
    shapes = (scale[:, None] * vectors)[list(moving)]
    left = list(range(len(values)))
    nearest = []
    for pole in seen.poles:
        nearest.append(min(left, key=lambda k: abs(values[k] - pole)))
        left.remove(nearest[-1])
    found = _still([shapes[:, k] for k, zero in zip(nearest, seen.at_zero, strict=True) if zero])
    for pole, k, zero in zip(seen.cleaned, nearest, seen.at_zero, strict=True):
        shape = shapes[:, k]
        if zero or pole.imag < 0.0 or not np.any(shape):
            continue
        found.append(_mode(complex(pole), shape))
    return found[:_MOST_MODES]


def _still(shapes: Sequence[Array]) -> list[dict[str, Any]]:
    """Modes at zero, each shape once."""
    kept: list[Array] = []
    basis = np.zeros((len(shapes[0]) if shapes else 0, 0))
    for shape in (np.real(shape) for shape in shapes):
        size = float(np.linalg.norm(shape))
        rest = shape - basis @ (basis.T @ shape)
        if size > 0.0 and np.linalg.norm(rest) > _OWN * size:
            kept.append(shape)
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
    return [_mode(0j, shape) for shape in kept]


def _mode(pole: complex, shape: Array) -> dict[str, Any]:
    """One mode, its largest displacement real and one."""
    shape = shape / shape[int(np.argmax(np.abs(shape)))]
    parts = [_short(np.real(shape)), _short(np.imag(shape))]
    return {"real": pole.real, "imag": pole.imag, "shape": parts}


def _short(numbers: Array) -> list[float]:
    return [float(f"{number:.{_DIGITS}g}") for number in numbers]


_POINT = 1e-9  # m: a scene that is smaller is one point


def view_data(
    scene: Scene,
    values: Mapping[str, float] | None = None,
    robot: str | Path | None = None,
    model: str | None = None,
) -> dict[str, Any]:
    """What the page of a scene shows; `values` are those that its sliders have at the beginning.

    The looks of the links of the file `robot` are added to the bodies of their names.

    A scene without an equilibrium, or without a linear model, is shown without loads and modes; the
    reason is among the `notes`.

    Raises
    ------
    SceneError, NotRationalError, WellPosednessError
        As `resolve`: names, units or the tree of the scene are wrong.
    TrimError
        A name of `values` is unknown, or a value is outside its range.
    """
    found = poses(scene)
    parameters = found.resolved.parameters
    chosen = chosen_point(parameters, values or {})
    drawing = draw(found, np.array([p.nominal for p in parameters]))
    notes = _add_looks(drawing, robot, model) if robot is not None else []
    positions = equilibrium_positions(found)
    data: dict[str, Any] = {
        "name": scene.name,
        "description": scene.description,
        "parameters": [
            {"name": p.name, "unit": p.unit, "low": p.low, "nominal": p.nominal, "high": p.high,
             "role": p.role, "value": value}
            for p, value in zip(parameters, chosen.tolist(), strict=True)
        ],
        "items": drawing.items,
        "tape": tape_of(drawing.function()).as_data(),
        "size": reach(drawing),
        "up": up_direction(drawing),
        "notes": notes,
    }  # fmt: skip
    listed = [ca.SX(0) if position is None else position for position in positions]
    function = found.as_function(ca.vertcat(*listed), "positions")
    data["positions"] = tape_of(function).as_data()
    data["coordinates"] = _coordinates(found, positions, data["size"])
    _add_loops(data, found)
    _add_dynamics(data, scene, chosen)
    return data


def _add_looks(drawing: Drawing, robot: str | Path, model: str | None) -> list[str]:
    """Add the meshes and primitives of a robot to its bodies; sentences on what is missing."""
    looks = robot_looks(robot, model)
    bodies = {item["name"]: item for item in drawing.items if _is_body(item)}
    left = [name for name in looks.shapes if name not in bodies]
    for name, shapes in looks.shapes.items():
        if name not in bodies:
            continue
        at = drawing.frame(name)
        bodies[name]["shapes"] += [
            {"type": "mesh", "at": at, "geometry": geometry, "layer": "meshes"}
            for geometry in shapes
        ]
    if left:
        looks.notes.append(f"The scene has no body for the shapes of {', '.join(left)}.")
    return list(dict.fromkeys(looks.notes))


def _is_body(item: Item) -> bool:
    return item["group"] == "bodies" or (item["group"], item["name"]) == ("world", GROUND)


def reach(drawing: Drawing) -> float:
    """The largest extent of what is drawn at nominal and at equilibrium (m); 1 if there is none.

    What stands on the ground as a shape does not count.
    """
    points = drawing.numbers(ca.horzcat(*_points(drawing))).reshape(-1, 3)
    points = np.concatenate([points, *_extents(drawing)])
    extent = float(np.max(np.ptp(points, axis=0), initial=0.0))
    return extent if extent > _POINT and math.isfinite(extent) else 1.0


def up_direction(drawing: Drawing) -> list[float]:
    """Against gravity; z without gravity."""
    gravity = drawing.numbers(drawing.poses.view.gravity)
    size = float(np.linalg.norm(gravity))
    return [0.0, 0.0, 1.0] if size == 0.0 else [float(-entry / size) for entry in gravity]


def _points(drawing: Drawing) -> list[ca.SX]:
    """The points, without the directions, of all shapes."""
    numbers: set[int] = set()
    for item in drawing.items:
        for shape in item["shapes"]:
            at = shape.get("at", shape.get("points"))
            whole = shape["type"] in ("stick", "curve", "line", "spring")
            numbers.update(at if whole else [at[0] if isinstance(at, list) else at])
    return [drawing.vectors[number] for number in sorted(numbers)]


def _extents(drawing: Drawing) -> list[Array]:
    """The least and the largest corner of each shape of a link, (2, 3) each."""
    found = []
    for item in drawing.items:
        for shape in item["shapes"]:
            if shape["type"] == "mesh" and "extent" in shape["geometry"]:
                low, high = np.array(shape["geometry"]["extent"])
                vectors = drawing.numbers(ca.horzcat(*(drawing.vectors[k] for k in shape["at"])))
                r, *axes = vectors.reshape(4, 3)
                reached = np.abs(np.array(axes)).T @ (0.5 * (high - low))
                middle = r + np.array(axes).T @ (0.5 * (high + low))
                found.append(np.array([middle - reached, middle + reached]))
    return found


def _coordinates(found: Poses, positions: list[ca.SX | None], size: float) -> list[dict[str, Any]]:
    """Coordinates in the order of q, with the reach of their sliders to either side."""
    listed: list[dict[str, Any]] = []
    for owned in found.owned:
        for freedom in owned.freedoms:
            turns = freedom.turns
            listed.append(
                {
                    "name": f"{owned.name}.{freedom.measures[0].name}",
                    "owner": owned.name,
                    "elastic": owned.kind == "elastic",
                    "unit": freedom.measures[0].unit,
                    "turns": turns,
                    "placed": positions[len(listed)] is not None,
                    "reach": math.pi if turns else 0.5 * size,
                }
            )
    return listed


def _add_loops(data: dict[str, Any], found: Poses) -> None:
    """The gaps of closures, with their slopes, and which coordinates close them."""
    symbols, rows = found.resolved.symbols, gaps(found)
    data["loops"] = None
    if rows.numel():
        slopes = ca.jacobian(rows, symbols.q)
        function = found.as_function(ca.horzcat(rows, slopes), "gaps")
        data["loops"] = {"tape": tape_of(function).as_data(), "rows": rows.numel(), "follow": []}


def _add_dynamics(data: dict[str, Any], scene: Scene, chosen: Array) -> None:
    """Loads at equilibrium and modes, or a note that says why there are none."""
    data |= {"trim": None, "modes": [], "states": []}
    try:
        equations = assemble(scene)
        n = equations.degrees_of_freedom
        data["states"] = [state for state in equations.states if state < n]
        if data["loops"]:
            free = set(data["states"])
            data["loops"]["follow"] = [k for k in range(n) if k not in free]
        data["trim"] = trim_data(equations)
        data["modes"] = mode_data(scene, equations, chosen)
    except MbdlftError as error:
        data["notes"].append(str(error))
    if data["loops"] and not data["loops"]["follow"]:
        data["loops"] = None  # nothing is known to follow
