"""Everything that a page shows, as plain data: items, tapes, parameters, coordinates, modes."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import MbdlftError
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.body import GROUND
from mbdlft.multibody.scene.scene import Scene
from mbdlft.show.viewer.drawing import Drawing, Item, draw
from mbdlft.show.viewer.looks import robot_looks
from mbdlft.show.viewer.modes import chosen_point, mode_data, trim_data
from mbdlft.show.viewer.poses import Poses, equilibrium_positions, gaps, poses
from mbdlft.show.viewer.tape import tape_of

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
