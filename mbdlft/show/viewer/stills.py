"""Pictures of a scene at nominal, still or moving, as SVG, for what is printed or has no scripts."""

import html
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.multibody.scene.scene import Scene
from mbdlft.show.viewer.data import reach, up_direction
from mbdlft.show.viewer.drawing import Drawing, Shape, draw
from mbdlft.show.viewer.poses import scene_poses

_COLORS = ("#4477aa", "#aa7711", "#228833", "#aa3377", "#777777", "#cc6677", "#2a9d8f", "#8a7a2a")
_AXIS, _FORCE, _TORQUE, _SENSOR, _GROUND = "#1f4f9f", "#c0501a", "#9a2a6a", "#107040", "#6a40b0"
_GROUND_AXES = ("#c02020", "#208020", "#2040c0")
_SIZE, _MARGIN = 300.0, 40.0  # of the drawing, and around it
_LETTER, _LINE = 6.6, 12.0  # width of a letter, height of a line
_MOST_NAMES = 200  # places for more take time that grows with the third power
_NEAR = 11.0  # names that are further away from their point have a line to it
_DIRECTIONS = (-0.25, 0.25, -0.75, 0.75, 0.0, 1.0, -0.5, 0.5, -0.12, 0.12, -0.88, 0.88)  # of pi
_HALO = 'paint-order="stroke" stroke="white" stroke-width="2.5"'  # of letters, on what is behind


class View(NamedTuple):
    """Where the eye is (rad): about the vertical, from x; and above the horizon. Whether with names."""

    azimuth: float
    height: float
    names: bool


@dataclass(slots=True)
class _Sheet:
    """The plane of the picture: projected points (x to the right, y down), and what is drawn."""

    right: Array
    above: Array
    toward: Array
    scale: float
    strokes: list[tuple[float, str]] = field(default_factory=list)  # depth, SVG text
    ends: list[tuple[float, float]] = field(default_factory=list)
    names: list[tuple[float, float, str, str]] = field(default_factory=list)  # point, text, color

    def at(self, point: Array) -> tuple[float, float]:
        x, y = self.scale * float(self.right @ point), -self.scale * float(self.above @ point)
        self.ends.append((x, y))
        return x, y

    def line(self, points: Sequence[Array], color: str, width: float, more: str = "") -> None:
        """A line through points (3,)."""
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(self.at, points))
        depth = float(np.mean([self.toward @ point for point in points]))
        text = (
            f'<polyline points="{path}" fill="none" stroke="{color}" '
            f'stroke-width="{width}" stroke-linecap="round" stroke-linejoin="round"{more}/>'
        )
        self.strokes.append((depth, text))

    def dot(self, point: Array, color: str, radius: float, edge: str = "none") -> None:
        """A ball."""
        x, y = self.at(point)
        depth = float(self.toward @ point) + 1e-3
        text = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{color}" stroke="{edge}"/>'
        self.strokes.append((depth, text))

    def arrow(self, start: Array, end: Array, color: str, width: float) -> None:
        """A line with a head; one that points at the eye is a dot in a ring."""
        (x, y), (a, b) = self.at(start), self.at(end)
        dx, dy = a - x, b - y
        long = math.hypot(dx, dy)
        depth = float(self.toward @ end) + 2e-3
        if long < 4.0:
            inner = "currentColor" if self.toward @ (end - start) > 0 else "none"
            text = (
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="white" stroke="{color}"/>'
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2" color="{color}" fill="{inner}"/>'
            )
            self.strokes.append((depth, text))
            return
        head = min(9.0, 0.6 * long)
        ex, ey = dx / long, dy / long
        tip = f"{a:.1f},{b:.1f}"
        for side in (0.4, -0.4):
            tip += f" {a - head * (ex - side * ey):.1f},{b - head * (ey + side * ex):.1f}"
        text = (
            f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{a - 0.6 * head * ex:.1f}" '
            f'y2="{b - 0.6 * head * ey:.1f}" stroke="{color}" stroke-width="{width}"/>'
            f'<polygon points="{tip}" fill="{color}"/>'
        )
        self.strokes.append((depth, text))

    def label(self, point: Array, text: str, color: str) -> None:
        """A name at a point; `labels` says where it stands."""
        self.names.append((*self.at(point), text, color))

    def labels(self) -> list[str]:
        """The names as texts of SVG, each where it covers no other, with a line to its point."""
        taken: list[_Box] = []
        drawn = []
        shown, more = self.names[:_MOST_NAMES], self.names[_MOST_NAMES:]
        shown += [(*name[:2], f"and {len(more)} more", name[3]) for name in more[:1]]
        for x, y, text, color in shown:
            box = next(box for box in _around(x, y, _LETTER * len(text)) if not box.meets(taken))
            taken.append(box)
            self.ends += [(box.left + _MARGIN - 4.0, box.top), (box.right - _MARGIN + 4.0, box.bottom)]
            end = min(max(x, box.left), box.right), min(max(y, box.top), box.bottom)
            if math.dist(end, (x, y)) > _NEAR:
                drawn.append(
                    f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{end[0]:.1f}" y2="{end[1]:.1f}" '
                    f'stroke="{color}" stroke-width="0.6"/>'
                )
            drawn.append(
                f'<text x="{box.left:.1f}" y="{box.bottom - 3.0:.1f}" fill="{color}" {_HALO}>'
                f"{html.escape(text)}</text>"
            )
        return drawn


class _Box(NamedTuple):
    left: float
    top: float
    right: float
    bottom: float

    def meets(self, others: Sequence["_Box"]) -> bool:
        return any(
            self.left < other.right
            and other.left < self.right
            and self.top < other.bottom
            and other.top < self.bottom
            for other in others
        )


def _around(x: float, y: float, wide: float) -> Iterator[_Box]:
    """Boxes for a name of a width on rings about its point, the nearest first."""
    for ring in itertools.count():
        radius = 6.0 + 8.0 * ring
        for direction in _DIRECTIONS:
            i, j = (max(-1.0, min(1.0, 1.5 * side(math.pi * direction))) for side in (math.cos, math.sin))
            left, top = x + i * (radius + 0.5 * wide) - 0.5 * wide, y + (radius + 0.5 * _LINE) * j
            yield _Box(left, top - 0.5 * _LINE, left + wide, top + 0.5 * _LINE)


def scene_picture(scene: Scene, azimuth: float = 0.9, height: float = 0.35, *, names: bool = True) -> str:
    """The picture of a scene at nominal and at equilibrium, as an SVG element; arguments as of `View`."""
    return scene_pictures(scene, [View(azimuth, height, names)])[0]


def scene_pictures(scene: Scene, views: Sequence[View]) -> list[str]:
    """As `scene_picture`, from several sides."""
    drawing, nominal = _at_nominal(scene)
    count = sum(len(owned.freedoms) for owned in drawing.poses.owned)
    vectors = np.asarray(drawing.function()(nominal, np.zeros(count))).reshape(-1, 3)
    size, up = reach(drawing), np.array(up_direction(drawing))
    pictures = []
    for view in views:
        sheet = _sheet(up, view.azimuth, view.height, _SIZE / size)
        for number, item in enumerate(drawing.items):
            color = _COLORS[number % len(_COLORS)]
            for shape in item["shapes"]:
                _draw_shape(sheet, shape, vectors, color, size)
            if view.names:
                _name(sheet, item, vectors, color)
        labels = sheet.labels()  # in front of all lines
        body = "\n".join([_strokes(sheet), *labels])
        pictures.append(_element(sheet.ends, drawing.poses.scene.name, body))
    return pictures


def scene_film(
    scene: Scene, displacements: Sequence[Array], seconds: float, azimuth: float, height: float
) -> str:
    """The moving picture of a scene at nominal, as an SVG element that begins again at its end.

    It has bodies and what rolls, at `displacements` (n,) of all coordinates from the equilibrium, one for
    each frame; `seconds` is the length of the film. Where nothing moves, the first frame is seen.
    """
    drawing, nominal = _at_nominal(scene)
    function, frames, ends = drawing.function(), list[str](), list[tuple[float, float]]()
    size, up = reach(drawing), np.array(up_direction(drawing))
    for k, moved in enumerate(displacements):
        vectors = np.asarray(function(nominal, moved)).reshape(-1, 3)
        sheet = _sheet(up, azimuth, height, _SIZE / size)
        for number, item in enumerate(drawing.items):
            for shape in item["shapes"]:
                if item["group"] in ("bodies", "contacts") and shape["type"] in (
                    "stick",
                    "curve",
                    "mass",
                ):
                    _draw_shape(sheet, shape, vectors, _COLORS[number % len(_COLORS)], size)
        shown = "visible" if k == 0 else "hidden"
        begin = (k / len(displacements) - 1.0) * seconds
        frames.append(
            f'<g visibility="{shown}"><animate attributeName="visibility" values="visible;hidden" '
            f'keyTimes="0;{1.0 / len(displacements):.5f}" calcMode="discrete" dur="{seconds:g}s" '
            f'begin="{begin:.4f}s" repeatCount="indefinite"/>{_strokes(sheet)}</g>'
        )
        ends += sheet.ends
    return _element(ends, scene.name, "\n".join(frames))


def _at_nominal(scene: Scene) -> tuple[Drawing, Array]:
    """What is drawn of a scene, and the nominal values (n_p,) of its parameters."""
    placed = scene_poses(scene)
    nominal = np.array([p.nominal for p in placed.resolved.parameters])
    return draw(placed, nominal), nominal


def _sheet(up: Array, azimuth: float, height: float, scale: float) -> _Sheet:
    """The plane across the line of sight."""
    first = np.eye(3)[int(np.argmin(np.abs(up)))]
    if np.argmax(np.abs(up)) == 2:
        first = np.array([1.0, 0.0, 0.0])
    x = first - up * (up @ first)
    x = x / np.linalg.norm(x)
    y = np.cross(up, x)
    level = math.cos(azimuth) * x + math.sin(azimuth) * y
    toward = math.cos(height) * level + math.sin(height) * up
    right = np.cross(up, level)
    return _Sheet(right, np.cross(toward, right), toward, scale)


def _draw_shape(sheet: _Sheet, shape: Shape, v: Array, color: str, size: float) -> None:
    """One shape, as far as it is in still pictures."""
    kind, unit = shape["type"], 0.01 * size
    if kind in ("stick", "curve"):
        sheet.line([v[k] for k in shape["points"]], color, 5.0, ' opacity="0.85"')
    elif kind == "line":
        sheet.line([v[k] for k in shape["points"]], "#30343b", 1.0, ' stroke-dasharray="3 2"')
    elif kind == "spring":
        first, second = (v[k] for k in shape["points"])
        sheet.line(list(_coil(first, second, sheet, unit)), "#444a55", 1.0)
    elif kind == "dot":
        sheet.dot(v[shape["at"]], color, 7.0)
    elif kind == "mass":
        sheet.dot(v[shape["at"]], "white", 3.0 + 3.0 * shape["share"], "#222222")
        sheet.dot(v[shape["at"]], "#222222", 1.5)
    elif kind == "joint":
        sheet.dot(v[shape["at"]], "#30343b", 2.5 if shape["kind"] == "fixed" else 3.5)
    elif kind in ("turn", "slide"):
        at, along = v[shape["at"]], v[shape["along"]]
        behind = 5.0 * unit if kind == "turn" else 0.0
        sheet.arrow(at - behind * along, at + 10.0 * unit * along, _AXIS, 1.4)
    elif kind in ("force", "torque"):
        shade = _FORCE if kind == "force" else _TORQUE
        _draw_vector(sheet, v[shape["at"]], v[shape["along"]], 14.0 * unit, shade)
    elif kind == "arrow":
        _draw_vector(sheet, v[shape["at"]], v[shape["along"]], 18.0 * unit, _GROUND)
    elif kind == "frame" and shape.get("big"):
        r, *axes = (v[k] for k in shape["at"])
        for axis, shade in zip(axes, _GROUND_AXES, strict=True):
            sheet.arrow(r, r + 12.0 * unit * axis, shade, 1.2)
    elif kind == "sensor":
        sheet.dot(v[shape["at"][0]], _SENSOR, 3.0)


def _draw_vector(sheet: _Sheet, at: Array, along: Array, length: float, color: str) -> None:
    """An arrow of this length along a vector; nothing where that is zero at nominal."""
    size = float(np.linalg.norm(along))
    if 0.0 < size < math.inf:
        sheet.arrow(at, at + length / size * along, color, 2.0)


def _coil(a: Array, b: Array, sheet: _Sheet, unit: float) -> Iterator[Array]:
    """Points of a zigzag between two points."""
    along = b - a
    across = np.cross(sheet.toward, along)
    wide = float(np.linalg.norm(across))
    across = across / wide if wide > 0.0 else across
    for k in range(25):
        side = 0.0 if k in (0, 24) else (1.0 if k % 2 else -1.0)
        yield a + along * (k / 24.0) + 1.4 * unit * side * across


def _name(sheet: _Sheet, item: dict[str, object], v: Array, color: str) -> None:
    """The name of an item, at its first shape; of a stick in its middle."""
    group = str(item["group"])
    shades = {"bodies": color, "joints": _AXIS, "loads": _FORCE, "sensors": _SENSOR}
    shapes = item["shapes"]
    if group not in shades or item["kind"] == "fixed" or not isinstance(shapes, list):
        return
    drawn = [shape for shape in shapes if shape["type"] != "frame"]
    if not drawn:  # a buoyancy without gravity
        return
    first: Shape = drawn[0]
    at = first.get("at", first.get("points"))
    numbers = at if isinstance(at, list) else [at]
    middle = group == "bodies" and len(numbers) > 1
    point = 0.5 * (v[numbers[0]] + v[numbers[-1]]) if middle else v[numbers[0]]
    sheet.label(point, str(item["name"]), shades[group])


def _strokes(sheet: _Sheet) -> str:
    return "\n".join(text for _, text in sorted(sheet.strokes, key=lambda stroke: stroke[0]))


def _element(points: Sequence[tuple[float, float]], name: str, body: str) -> str:
    """An element that holds the points."""
    ends, title = np.array(points), html.escape(name)
    low, high = ends.min(axis=0) - _MARGIN, ends.max(axis=0) + _MARGIN
    wide, tall = high - low
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{low[0]:.1f} {low[1]:.1f} {wide:.1f} '
        f'{tall:.1f}" width="{wide:.0f}" height="{tall:.0f}" font-family="sans-serif" '
        f'font-size="11" role="img"><title>{title}</title>\n{body}\n</svg>'
    )
