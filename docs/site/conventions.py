"""The drawing of conventions, written by `python -m docs.site.conventions` into docs/conventions.svg.

What it states about signs is the list `MOTIONS`, which the tests compare with the package.
"""

import io
import re
import sys
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

Vector = tuple[float, float, float]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_FILE = Path(__file__).parents[1] / "conventions.svg"
_AXIS, _CHILD, _PARENT, _MOVE, _LOAD = "#1f4f9f", "#228833", "#8a8f98", "#c0202a", "#c0501a"
_SHADES = {"x": "#c02020", "y": "#208020", "z": "#2040c0"}
_SHOW = np.array([[-0.42, -0.34], [0.94, -0.10], [0.0, 1.0]])  # x toward the reader, y right, z up


class Motion(NamedTuple):
    """A statement: where a small positive coordinate of a joint at zero moves a point of the child.

    Attributes
    ----------
    kind, axes : of the joint: its key `kind`, and its other keys
    output : the ending of its output, such as `angle` or `position.x`
    point : in the frame of the child, m
    moves : the direction of the point's motion; its length is that for a coordinate of 1 rad or 1 m
    """

    kind: str
    axes: dict[str, Vector]
    output: str
    point: Vector
    moves: Vector


MOTIONS = (
    Motion("revolute", {"axis": Z}, "angle", X, Y),
    Motion("revolute", {"axis": X}, "angle", Y, Z),
    Motion("revolute", {"axis": Y}, "angle", Z, X),
    Motion("prismatic", {"axis": Y}, "position", Z, Y),
    Motion("cylindrical", {"axis": Z}, "position", X, Z),
    Motion("cylindrical", {"axis": Z}, "angle", X, Y),
    Motion("universal", {"axis1": X, "axis2": Y}, "angle.1", Z, (0.0, -1.0, 0.0)),
    Motion("universal", {"axis1": X, "axis2": Y}, "angle.2", Z, X),
    Motion("planar", {"axis": Z}, "position.x", X, X),
    Motion("planar", {"axis": Z}, "position.y", X, Y),
    Motion("planar", {"axis": Z}, "angle", X, Y),
    Motion("planar", {"axis": X}, "position.x", Y, Y),
    Motion("planar", {"axis": X}, "position.y", Y, Z),
    Motion("planar", {"axis": Y}, "position.x", X, Z),
    Motion("planar", {"axis": Y}, "position.y", X, X),
    Motion("spherical", {}, "rotation.x", Z, (0.0, -1.0, 0.0)),
    Motion("spherical", {}, "rotation.z", X, Y),
)
_PANELS = (
    ("revolute, axis z", (0,)), ("revolute, axis y", (2,)), ("prismatic, axis y", (3,)),
    ("cylindrical, axis z", (4, 5)), ("universal, axes x and y", (6, 7)),
    ("planar, axis z: x is x, y is y", (8, 9, 10)), ("planar, axis x: x is y, y is z", (11, 12)),
    ("planar, axis y: x is z, y is x", (13, 14)),
)  # fmt: skip


def on_paper(point: object) -> np.ndarray:
    """Where a point (3,) is in the drawing."""
    return np.asarray(point, dtype=float) @ _SHOW


def _arrow(axes: Axes, start: object, end: object, color: str, width: float = 1.6) -> None:
    axes.annotate(
        "", on_paper(end), on_paper(start),
        arrowprops={"arrowstyle": "-|>", "color": color, "lw": width, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip


def _write(axes: Axes, point: object, text: str, color: str, ha: str = "left") -> None:
    x, y = on_paper(point)
    axes.text(x, y, text, color=color, ha=ha, va="center", fontsize=8.5)


def _line(axes: Axes, points: list[object], color: str, width: float, style: str = "-") -> None:
    xy = np.array([on_paper(point) for point in points])
    axes.plot(xy[:, 0], xy[:, 1], style, color=color, linewidth=width, solid_capstyle="round")


def _prepare(axes: Axes, title: str) -> None:
    axes.set(xlim=(-1.05, 1.45), ylim=(-0.8, 1.3), aspect="equal")
    axes.axis("off")
    axes.set_title(title, fontsize=9.5)


def _draw_frame(axes: Axes, origin: object, size: float, names: str = "") -> None:
    for name, along in zip("xyz", (X, Y, Z), strict=True):
        end = np.asarray(origin) + size * np.asarray(along)
        _arrow(axes, origin, end, _SHADES[name], 1.3)
        if names:
            _write(axes, end + 0.12 * np.asarray(along), name, _SHADES[name], "center")


def _draw_turn(axes: Axes, along: Vector) -> None:
    """The bent arrow about an axis: fingers of the right hand."""
    n = np.asarray(along)
    a = np.roll(n, 1)
    b = np.cross(n, a)
    angles = np.linspace(-0.6, 4.0, 40)
    ring = [0.62 * n + 0.16 * (np.cos(t) * a + np.sin(t) * b) for t in angles]
    _line(axes, ring, _AXIS, 1.1)
    _arrow(axes, ring[-3], ring[-1], _AXIS, 1.1)


def _draw_joint(axes: Axes, motions: list[Motion]) -> None:
    """The axes of a joint, its child at zero and displaced, and the arrows of positive motion."""
    _draw_frame(axes, (0, 0, 0), 0.3)
    axes.plot(*on_paper((0, 0, 0)), "s", color=_PARENT, markersize=9)
    for name, along in motions[0].axes.items():
        _arrow(axes, (0, 0, 0), 0.95 * np.asarray(along), _AXIS)
        _write(axes, 1.08 * np.asarray(along), name, _AXIS, "center")
        turns = any("angle" in motion.output for motion in motions)
        if turns:
            _draw_turn(axes, along)
    for motion in motions:
        point, moves = np.asarray(motion.point), np.asarray(motion.moves)
        short, step = 0.7 * point, 0.5 * moves
        _line(axes, [(0, 0, 0), short], _CHILD, 3.0)
        if motion.kind == "planar" and motion.output == "angle":
            _write(axes, np.add(0.62 * np.asarray(motion.axes["axis"]), (0, 0.25, 0)), "+angle", _MOVE)
            continue
        if "angle" in motion.output:
            turned = short * np.cos(0.5) + 0.7 * moves * np.sin(0.5)
            _line(axes, [(0, 0, 0), turned], _CHILD, 1.2, "--")
        else:
            _line(axes, [step, short + step], _CHILD, 1.2, "--")
        _arrow(axes, short, short + step, _MOVE, 2.0)
        right, up = on_paper(moves) / np.linalg.norm(on_paper(moves))
        x, y = on_paper(short + step) + 0.07 * np.array([right, up])
        ha = "left" if right > 0.3 else "right" if right < -0.3 else "center"
        below = up < 0.5 and right < 0.3
        axes.text(x, y + (0.07 if up > 0.5 else -0.06 if below else 0.0), f"+{motion.output}",
                  color=_MOVE, ha=ha, va="center", fontsize=8.5)  # fmt: skip


def _draw_frames(axes: Axes) -> None:
    """Ground, a body with its own frame, ports, and the center of mass; gravity."""
    _draw_frame(axes, (0, 0, 0), 0.55, "xyz")
    _write(axes, (0, 0.05, -0.3), "ground", _PARENT, "left")
    origin = np.array([0.0, 0.35, 0.75])
    tip = np.add(origin, (0, 0.95, 0.05))
    _line(axes, [origin, tip], _CHILD, 4.0)
    _draw_frame(axes, origin, 0.28)
    _write(axes, np.add(origin, (0, -0.15, 0.38)), "origin of the body", _CHILD, "center")
    axes.plot(*on_paper(tip), "o", color=_CHILD, markersize=6)
    _write(axes, np.add(tip, (0, 0, 0.17)), "port tip", _CHILD, "center")
    middle = 0.5 * (origin + tip)
    axes.plot(*on_paper(middle), "o", color="white", markeredgecolor="black", markersize=8)
    axes.plot(*on_paper(middle), ".", color="black", markersize=3)
    _write(axes, np.add(middle, (0, 0.06, -0.18)), "center of mass", "black", "left")
    _arrow(axes, (0, -0.75, 0.75), (0, -0.75, 0.25), "#6a40b0", 2.0)
    _write(axes, (0, -0.75, 0.9), "gravity", "#6a40b0", "center")


def _draw_efforts(axes: Axes) -> None:
    """What a positive effort does: on the child, and the opposite on the parent."""
    _line(axes, [(0, -0.9, 0), (0, 0, 0)], _PARENT, 5.0)
    _line(axes, [(0, 0, 0), (0, 0.9, 0.0)], _CHILD, 5.0)
    axes.plot(*on_paper((0, 0, 0)), "o", color="white", markeredgecolor=_AXIS, markersize=10)
    axes.plot(*on_paper((0, 0, 0)), ".", color=_AXIS, markersize=5)
    _write(axes, (0, 0.0, -0.25), "axis x, toward you", _AXIS, "center")
    for side, word in ((1.0, "on the child"), (-1.0, "on the parent")):
        bent = [(0, side * (0.2 + 0.45 * np.cos(t)), 0.5 * np.sin(t)) for t in np.linspace(0.3, 1.35, 20)]
        _line(axes, list(bent), _MOVE, 2.0)
        _arrow(axes, bent[-2], bent[-1], _MOVE, 2.0)
        _write(axes, (0, side * 0.62, 0.62), word, _MOVE, "center")
    _write(axes, (0, 0.0, 0.9), "+torque", _MOVE, "center")


def _draw_loads(axes: Axes) -> None:
    """A load turns with its body, or keeps its direction."""
    for offset, tilt in ((-0.75, 0.0), (0.45, 0.6)):
        foot = np.array([0.0, offset, 0.0])
        along = np.array([0.0, np.sin(tilt), np.cos(tilt)])
        _line(axes, [foot, foot + 0.65 * along], _CHILD, 4.0)
        _arrow(axes, foot + 0.65 * along, foot + 1.05 * along, _LOAD, 2.0)
        _arrow(axes, foot + 0.65 * along, np.add(foot + 0.65 * along, (0, 0.4, 0)), "#9a2a6a", 2.0)
    _write(axes, (0, 0.1, 1.22), 'frame = "body"', _LOAD, "center")
    _write(axes, (0, 0.0, 0.1), 'frame = "ground"', "#9a2a6a", "center")
    _write(axes, (0, -0.75, -0.2), "at equilibrium", "black", "center")
    _write(axes, (0, 0.5, -0.2), "turned", "black", "center")


def drawing() -> Figure:
    """The whole drawing."""
    figure = Figure(figsize=(11.0, 7.6), layout="constrained")
    grid = figure.subplots(3, 4).ravel()
    first = [("frames, ports, gravity", _draw_frames), ("an effort and its reaction", _draw_efforts),
             ("loads of two frames", _draw_loads)]  # fmt: skip
    for axes, (title, draw) in zip(grid, first, strict=False):
        _prepare(axes, title)
        draw(axes)
    for axes, (title, numbers) in zip(grid[3:], _PANELS, strict=False):
        _prepare(axes, title)
        _draw_joint(axes, [MOTIONS[k] for k in numbers])
    legend = grid[-1]
    _prepare(legend, "")
    rows = [("parent", _PARENT), ("axis, with the right hand", _AXIS), ("child at zero", _CHILD),
            ("where a positive coordinate moves it", _MOVE), ("x", _SHADES["x"]), ("y", _SHADES["y"]),
            ("z", _SHADES["z"])]  # fmt: skip
    for number, (text, color) in enumerate(rows):
        legend.text(-1.0, 1.2 - 0.27 * number, text, color=color, fontsize=9)
    return figure


def svg() -> str:
    """The text of the file; the same on every run."""
    stream = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "conventions", "svg.fonttype": "none"}):
        drawing().savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return re.sub(r"[ \t]+$", "", stream.getvalue(), flags=re.MULTILINE)


if __name__ == "__main__":
    _FILE.write_text(svg(), encoding="utf-8")
    sys.stdout.write(f"{_FILE}\n")
