"""Everything that a page shows, as plain data: items, tapes, parameters, coordinates, modes.

A page has no CasADi: functions of SX are written as tapes of straight-line operations, which its script
follows. Loads at the equilibrium are such a tape; modes are computed here, at samples of the parameters.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import MbdlftError, TrimError, WellPosednessError, check_known
from mbdlft.base.parameter import Parameter
from mbdlft.base.samples import corners, physical_points, random
from mbdlft.exact.rounding import eigenvectors_of
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.body import GROUND
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.to_problem import choose_signals
from mbdlft.problem.equations import Equations, physical_symbols, split
from mbdlft.problem.linearization import linearized, slope_function
from mbdlft.problem.sx.constants import in_doubles
from mbdlft.problem.sx.tapes import steps
from mbdlft.problem.trim import relations_at_rest, trim_efforts, trim_rows
from mbdlft.response.modes import balancing, spectrum
from mbdlft.show.viewer.drawing import Drawing, add_solids, draw
from mbdlft.show.viewer.looks import robot_looks
from mbdlft.show.viewer.poses import Poses, equilibrium_positions, gaps, scene_poses
from mbdlft.system.model import System

# the operations that `interpret` of assets/interpret.js knows, by their place in this list
OPERATIONS = (
    "const", "input", "output", "assign", "add", "sub", "mul", "div", "neg", "sq", "twice", "inv",
    "sqrt", "sin", "cos", "tan", "atan",
)  # fmt: skip


_MOST_CORNERS = 6  # parameters of which all corners are samples: 64 of them
_RANDOM = 24  # other samples
_MOST_NUMBERS = 120_000  # of all modes together: 1 MB of a page
_MOST_MODES = 40  # in a list that a reader scrolls
_INDEPENDENT = 1e-3  # of a shape at zero: less outside the span of the others is rounding of eigenvectors
_DIGITS = 5  # of shapes, which are seen only
_POINT = 1e-9  # m: a scene that is smaller is one point


def tape_of(function: ca.Function) -> dict[str, Any]:
    """The tape of a function of SX with one dense result, as plain data for JSON.

    Each of its `steps` is four integers: the place of an operation in `OPERATIONS`, the register of the
    result and those of the operands. An input has the number of its argument and of its entry, a
    constant its place in `constants`, an output the number of its entry in place of a register.
    `registers` and `outputs` say how many there are.
    """
    numbers: list[int] = []
    constants: dict[float, int] = {}
    for operation, target, sources in steps(function):
        if operation not in OPERATIONS:
            raise NotImplementedError(f"the operation {operation!r} of {function.name()!r}")
        code = OPERATIONS.index(operation)
        if operation == "const":
            numbers += [code, target, constants.setdefault(sources[0], len(constants)), 0]
        elif operation == "output":
            numbers += [code, target[1], sources[0], 0]
        else:
            numbers += [code, target, sources[0], sources[1] if len(sources) > 1 else 0]
    return {
        "steps": numbers,
        "constants": list(constants),
        "registers": int(function.sz_w()),
        "outputs": int(function.nnz_out(0)),
    }


def trim_data(equations: Equations) -> dict[str, Any]:
    """The loads u at equilibrium: 0 = offset + slopes unknown and the known ones, as a tape of p.

    The result of the tape is [offset ; slopes by columns ; known]; `rows` of the first two determine
    the `unknown` entries of u.
    """
    e = equations
    symbols = physical_symbols(e.parameters)
    offset, slopes, known = relations_at_rest(e, symbols)
    rows = list(trim_rows(e))
    relations = ca.vertcat(offset[rows], ca.vec(slopes[rows, :]), known)
    function = ca.Function("trim", [symbols[0]], [ca.densify(in_doubles(ca.densify(relations)))])
    return {
        "tape": tape_of(function),
        "unknown": list(e.unknown),
        "efforts": [{"name": s.name, "unit": s.unit} for s in e.u_signals],
    }


def mode_data(scene: Scene, equations: Equations, chosen: Array) -> list[dict[str, Any]]:
    """Modes at samples of the parameters: the chosen values, nominal, ends and corners of the ranges.

    Each sample has a `point`, its physical values, and `modes`: the eigenvalue `real`, `imag` (rad/s),
    and at zero the displacements `shape`, real and imaginary parts by coordinate; pages find the others.
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


def linear_data(scene: Scene, equations: Equations) -> dict[str, Any]:
    """Slopes of [residual ; outputs] at equilibrium by unknown and known signals: a tape of p and u.

    Its result has `rows`, by columns: of the `unknown` signals, whose first `states` are the derivatives,
    of the states, and of the `inputs`; `linearAt` of assets/linear.js solves them for A, B, C, D.
    """
    e = equations
    inputs, outputs = choose_signals(scene, e)
    unknown, _ = split(e, inputs)
    function = slope_function(e, tuple(inputs), tuple(outputs))
    return {
        "tape": tape_of(function),
        "rows": int(function.size1_out(0)),
        "unknown": unknown.numel(),
        "states": len(e.states),
        "inputs": [{"name": e.u_signals[k].name, "unit": e.u_signals[k].unit} for k in inputs],
        "outputs": [{"name": e.y_signals[k].name, "unit": e.y_signals[k].unit} for k in outputs],
    }


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
            ends = corners(parameters)
            points += list(np.stack([ends[p.name] for p in parameters], axis=1))
        inside = random(parameters, _RANDOM, 0)
        points += list(np.stack([inside[p.name] for p in parameters], axis=1))
    unique = {tuple(point): point for point in points}
    return np.array(list(unique.values())).reshape(len(unique), len(parameters))


def _modes(name: str, A: Array, moving: Sequence[int]) -> list[dict[str, Any]]:
    """Modes of one matrix (nx, nx), slowest first; one of each pair of those with displacements.

    Real parts on the axis, and poles at zero, are cleaned of rounding. Of the poles at zero there are as
    many as have independent shapes: a body that moves freely has a double pole for each.
    """
    with np.errstate(all="ignore"):
        scale = balancing(A)
        scaled = A * (scale / scale[:, None])
    if not np.isfinite(scaled).all():
        raise WellPosednessError(
            f"scene {name!r}: an entry of the linear model is not finite at a sample, so there are no "
            "modes. Masses, lengths or stiffnesses are of very different size."
        )
    poles = spectrum(scaled)
    values, _, vectors = eigenvectors_of(scaled)
    shapes = (scale[:, None] * vectors)[list(moving)]
    unmatched = list(range(len(values)))
    nearest = []
    for pole in poles.poles:
        nearest.append(min(unmatched, key=lambda k: abs(values[k] - pole)))
        unmatched.remove(nearest[-1])
    modes = _still([shapes[:, k] for k, zero in zip(nearest, poles.at_zero, strict=True) if zero])
    for pole, k, zero in zip(poles.cleaned, nearest, poles.at_zero, strict=True):
        if not zero and pole.imag >= 0.0 and np.any(shapes[:, k]):
            modes.append({"real": pole.real, "imag": pole.imag})
    return modes[:_MOST_MODES]


def _still(shapes: Sequence[Array]) -> list[dict[str, Any]]:
    """Modes at zero with independent shapes: each adds to an orthonormal basis of those before it."""
    modes: list[dict[str, Any]] = []
    basis = np.zeros((len(shapes[0]) if shapes else 0, 0))
    for shape in (np.real(shape) for shape in shapes):
        size = float(np.linalg.norm(shape))
        outside = shape - basis @ (basis.T @ shape)
        if size > 0.0 and np.linalg.norm(outside) > _INDEPENDENT * size:
            scaled = shape / shape[int(np.argmax(np.abs(shape)))]
            digits = [float(f"{number:.{_DIGITS}g}") for number in scaled]
            modes.append({"real": 0.0, "imag": 0.0, "shape": [digits, [0.0] * len(digits)]})
            basis = np.column_stack([basis, outside / np.linalg.norm(outside)])
    return modes


def view_data(
    scene: Scene,
    values: Mapping[str, float] | None = None,
    robot: str | Path | None = None,
    model: str | None = None,
) -> dict[str, Any]:
    """What the page of a scene shows; `values` are those that its sliders have at the beginning.

    Without an equilibrium or a linear model there are no loads and modes; `notes` have the reason.
    """
    placed = scene_poses(scene)
    parameters = placed.resolved.parameters
    (chosen,) = physical_points(parameters, values or {}, "view", TrimError)
    drawing = draw(placed, np.array([p.nominal for p in parameters]))
    notes = _add_looks(drawing, robot, model) if robot is not None else []
    add_solids(drawing)
    positions = equilibrium_positions(placed)
    data: dict[str, Any] = {
        "name": scene.name,
        "description": scene.description,
        "parameters": [
            {"name": p.name, "unit": p.unit, "low": p.low, "nominal": p.nominal, "high": p.high,
             "role": p.role, "value": value}
            for p, value in zip(parameters, chosen.tolist(), strict=True)
        ],
        "items": drawing.items,
        "tape": tape_of(drawing.function()),
        "size": reach(drawing),
        "up": up_direction(drawing),
        "notes": notes,
    }  # fmt: skip
    listed = [ca.SX(0) if position is None else position for position in positions]
    data["positions"] = tape_of(placed.as_function(ca.vertcat(*listed), "positions"))
    data["coordinates"] = _coordinates(placed, positions, data["size"])
    _add_loops(data, placed)
    _add_dynamics(data, scene, chosen)
    return data


def other_poles(other: Scene | System) -> dict[str, Any]:
    """What a scene is compared with at nominal: its poles, as pages draw them, and A, B, C, D."""
    if isinstance(other, Scene):
        e = assemble(other)
        points = np.array([[p.nominal for p in e.parameters]])
        efforts, _ = trim_efforts(e, points)
        n = len(e.states)
        inputs, outputs = choose_signals(other, e)
        whole = linearized(e, inputs, outputs, points, efforts)[0]
        A, B, C, D = whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]
        names = [e.u_signals[k].name for k in inputs], [e.y_signals[k].name for k in outputs]
    else:
        A, B, C, D = other.A, other.B_u, other.C_y, other.D_yu
        names = [s.name for s in other.inputs], [s.name for s in other.outputs]
    eigenvalues = spectrum(A).cleaned
    return {
        "kind": "other",
        "title": f"poles of {other.name} at nominal",
        "poles": [[float(pole.real), float(pole.imag)] for pole in eigenvalues],
        **{key: matrix.tolist() for key, matrix in (("A", A), ("B", B), ("C", C), ("D", D))},
        "inputs": names[0],
        "outputs": names[1],
    }


def placed_at(scene: Scene, title: str, values: Mapping[str, float]) -> dict[str, Any]:
    """Values of all parameters of a scene, in its order; those that are not named are nominal.

    They may be outside of the ranges, as the worst cases of margins are.
    """
    nominal = {p.name: p.nominal for p in sorted(scene.parameters, key=lambda p: p.name)}
    check_known("parameter", values, nominal, f"view, {title}", TrimError)
    return {"title": title, "point": [float(x) for x in (nominal | dict(values)).values()]}


def _add_looks(drawing: Drawing, robot: str | Path, model: str | None) -> list[str]:
    """Add the meshes and primitives of a robot to its bodies; sentences on what is missing."""
    looks = robot_looks(robot, model)
    bodies = {
        item["name"]: item
        for item in drawing.items
        if item["group"] == "bodies" or (item["group"], item["name"]) == ("world", GROUND)
    }
    for name in (name for name in looks.shapes if name in bodies):
        at = drawing.frame(name)
        bodies[name]["shapes"] += [
            {"type": "mesh", "at": at, "geometry": geometry, "layer": "meshes"}
            for geometry in looks.shapes[name]
        ]
    if without := [name for name in looks.shapes if name not in bodies]:
        looks.notes.append(f"The scene has no body for the shapes of {', '.join(without)}.")
    return list(dict.fromkeys(looks.notes))


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
    boxes = []
    for item in drawing.items:
        for shape in item["shapes"]:
            if shape["type"] == "mesh" and "extent" in shape["geometry"]:
                low, high = np.array(shape["geometry"]["extent"])
                vectors = drawing.numbers(ca.horzcat(*(drawing.vectors[k] for k in shape["at"])))
                r, *axes = vectors.reshape(4, 3)
                reached = np.abs(np.array(axes)).T @ (0.5 * (high - low))
                middle = r + np.array(axes).T @ (0.5 * (high + low))
                boxes.append(np.array([middle - reached, middle + reached]))
    return boxes


def _coordinates(placed: Poses, positions: Sequence[ca.SX | None], size: float) -> list[dict[str, Any]]:
    """Coordinates in the order of q, with the reach of their sliders to either side."""
    freedoms = [(owned, freedom) for owned in placed.owned for freedom in owned.freedoms]
    return [
        {
            "name": f"{owned.name}.{freedom.measures[0].name}",
            "owner": owned.name,
            "elastic": owned.kind == "elastic",
            "unit": freedom.measures[0].unit,
            "turns": freedom.turns,
            "placed": position is not None,
            "reach": math.pi if freedom.turns else 0.5 * size,
        }
        for (owned, freedom), position in zip(freedoms, positions, strict=True)
    ]


def _add_loops(data: dict[str, Any], placed: Poses) -> None:
    """The gaps of closures, with their slopes, and which coordinates close them."""
    rows = gaps(placed)
    data["loops"] = None
    if rows.numel():
        slopes = ca.jacobian(rows, placed.resolved.symbols.q)
        tape = tape_of(placed.as_function(ca.horzcat(rows, slopes), "gaps"))
        data["loops"] = {"tape": tape, "rows": rows.numel(), "follow": []}


def _add_dynamics(data: dict[str, Any], scene: Scene, chosen: Array) -> None:
    """Loads at equilibrium and modes, or a note that says why there are none."""
    data |= {"trim": None, "linear": None, "modes": [], "states": []}
    try:
        equations = assemble(scene)
        n = equations.degrees_of_freedom
        data["states"] = [state for state in equations.states if state < n]
        if data["loops"]:
            free = set(data["states"])
            data["loops"]["follow"] = [k for k in range(n) if k not in free]
        data["trim"] = trim_data(equations)
        data["modes"] = mode_data(scene, equations, chosen)
        data["linear"] = linear_data(scene, equations)
    except MbdlftError as error:
        data["notes"].append(str(error))
    if data["loops"] and not data["loops"]["follow"]:
        data["loops"] = None  # nothing is known to follow
