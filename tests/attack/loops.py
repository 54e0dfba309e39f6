"""Closed loops with a flat position known in closed form: in the range no loop may be called proved.

A flat position is one where the constraints of a loop lose rank: branches of the motion meet, a second
freedom appears, and there is no linear model. Each family says where that is. All mechanisms but the
strut and the shafts move in the plane xy, with bars along their x axis.

| family         | closed by         | flat where                                            |
|----------------|-------------------|-------------------------------------------------------|
| shafts         | universal joint   | an arm of the cross lies along the other shaft        |
| two_rails      | hinge, ball       | both rails are parallel                               |
| slider_crank   | hinge, slide, sleeve | crank and rod of one length lie on each other      |
| swinging_block | slide, sleeve     | the rod has length zero                               |
| four_slides    | weld, slide       | all slides are parallel                               |
| parallelogram  | hinge, ball       | all bars are on one line, or both on one pivot        |
| two_angles     | hinge, ball       | crank and rod are both across the rail                |
| strut          | ball              | it has length zero, or lies along an axis of its universal joint |
| stacked        | two hinges, balls | one of two parallelograms, one on the other, is       |
| scissors       | two hinges, balls | both bars are upright                                 |
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import flint
import numpy as np

import mbdlft
from mbdlft import Angle, Beam, Ground, Loop, MbdlftError, Parameter, Rotation, Scene
from mbdlft.multibody.joint import Joint
from tests import kit
from tests.attack.mutations import check_message
from tests.cross.maximal import Bodies
from tests.cross.poses import BITS

Z = (0.0, 0.0, 1.0)
_LOST = 1e-7  # of the largest singular value: one below it is lost
_SAMPLES = 8


class Draft:
    """A loop in the making: 1 to 6 parameters, the first of which come to the flat position or do not."""

    def __init__(self, seed: int, *, flat: bool) -> None:
        self.random = np.random.default_rng(seed)
        self.is_flat = flat
        self.count = int(self.random.integers(1, 7))
        self.parameters: list[Parameter] = []
        self.at: dict[str, float] = {}  # the flat position
        self.bodies: list[mbdlft.Body] = []
        self.joints: list[Joint] = []
        self.loops: list[Loop] = []
        self.ports: dict[str, Any] = {}

    def chance(self, probability: float) -> bool:
        return bool(self.random.random() < probability)

    def one_of(self, *choices: Any) -> Any:
        return choices[int(self.random.integers(len(choices)))]

    def planted(self, name: str, at: float, away: float, unit: str = "deg") -> str:
        """A parameter with the nominal value `at` + `away`, whose range has `at` if the loop is flat.

        That is in the range, at its end, or in one of ten cases the nominal value itself.
        """
        near = float(self.random.uniform(0.1, 0.5)) * away
        if self.is_flat:
            near = float(self.one_of(0.0, -1e-3 * away, -near, -near))
        is_nominal = self.is_flat and near != 0.0 and self.chance(0.1)
        nominal = at if is_nominal else at + away
        low, high = sorted((at + near, at + float(self.random.uniform(1.1, 1.4)) * away))
        kind: Any = Angle if unit == "deg" else partial(Parameter, unit=unit)
        self.parameters.append(kind(name, nominal, low=low, high=high))
        self.at[name] = at
        return name

    def size(self, name: str, low: float, high: float, unit: str) -> float | str:
        """A number, or a parameter while there may be more of them."""
        value = float(self.random.uniform(low, high))
        if len(self.parameters) >= self.count or self.chance(0.3):
            return value
        percent = float(self.random.uniform(5.0, 30.0))
        self.parameters.append(Parameter(name, value, percent=percent, unit=unit))
        return name

    def length(self, name: str = "L") -> float | str:
        return self.size(name, 0.4, 1.5, "m")

    def bar(self, name: str, length: float | str, **ports: Any) -> str:
        """A bar along x with a port at its tip."""
        x, y, z = (float(value) for value in self.random.uniform(-0.2, 0.2, 3))
        size = float(self.random.uniform(0.05, 0.2))
        moments, center = (size, 1.2 * size, 0.9 * size), (0.3 + x, y, z)
        where = {"about": "center_of_mass", "ports": {"tip": (length, 0, 0), **ports}}
        mass = self.size(f"m_{name}", 0.4, 1.5, "kg")
        self.bodies.append(kit.body(name, mass, moments, center_of_mass=center, **where))
        return name

    def link(self, name: str, length: float | str) -> str:
        """A bar, or in one of five cases a beam that bends in the plane."""
        if self.chance(0.8):
            return self.bar(name, length)
        self.bodies.append(
            Beam(
                name=name, length=length, density=self.size(f"rho_{name}", 2000.0, 8000.0, "kg/m^3"),
                area=1e-4, modulus=7e10, I_z=1e-9, I_y=1e-9, elements=1, deformations=("bending_y",),
                prestress="neglected",
            )
        )  # fmt: skip
        return name

    def hinge(self, name: str, parent: str, child: str, position: Any = 0.0, **fields: Any) -> None:
        """A hinge about z; one that nothing drives has the effort 0."""
        fields = {"preload": 0, "position": position} | fields
        self.joints.append(kit.hinge(name, parent, child, Z, **fields))

    def driven(self) -> dict[str, Any]:
        """Fields of a joint that its effort holds at equilibrium."""
        stiffness = self.size("k", 20.0, 60.0, "N m/rad")
        return {"preload": None, "stiffness": stiffness, "damping": float(self.random.uniform(0.0, 1.0))}

    def slide(self, name: str, parent: str, child: str, position: Any, **fields: Any) -> None:
        """A slide along x."""
        fields = {"axis": (1.0, 0.0, 0.0), "preload": 0, "position": position} | fields
        self.joints.append(kit.rail(name, parent, child, **fields))

    def close(self, name: str, parent: str, child: str, kind: str, **fields: Any) -> None:
        axes = {"revolute": Z, "prismatic": (1.0, 0.0, 0.0), "cylindrical": (1.0, 0.0, 0.0)}
        axis = {"axis": axes[kind]} if kind in axes else {}
        self.loops.append(kit.loop(name, kind, parent, child, **axis, **fields))

    def pin(self, name: str, parent: str, child: str) -> None:
        """A loop that a hinge or a ball closes."""
        self.close(name, parent, child, self.one_of("revolute", "spherical"))

    def scene(self, name: str) -> Scene:
        gravity = (0.0, -9.81, 0.0) if self.chance(0.5) else (0.0, 0.0, 0.0)
        bodies = Ground(ports=self.ports), *self.bodies
        return kit.scene(name, *self.parameters, *bodies, *self.joints, *self.loops, gravity=gravity)


def _turned(angle: float | str) -> list[Rotation]:
    return [kit.turn(Z, angle)]


def parallelogram(d: Draft) -> None:
    """Bars of length L at the angle th on pivots d apart: flat at th = 0 or 180 deg, or d = 0."""
    where = d.one_of("line", "line", "pivot")
    if where == "line":
        side = d.one_of(0.0, 180.0)
        th = d.planted("th", side, (1 if side == 0.0 else -1) * float(d.random.uniform(20.0, 70.0)))
        base = d.length("d")
    else:
        base, th = d.planted("d", 0.0, float(d.random.uniform(0.3, 1.0)), "m"), "th"
        d.parameters.append(Angle("th", 50.0, low=30.0, high=float(d.random.uniform(55.0, 120.0))))
    _parallelogram(d, "", "ground", "ground.u", th, base, d.bar if where == "pivot" else d.link)
    d.ports["u"] = (base, 0, 0)


def _parallelogram(
    d: Draft, mark: str, foot: str, other: str, th: str, base: Any, coupler_of: Callable[[str, Any], str]
) -> None:
    length = d.length(f"L{mark}")
    left, right = d.bar(f"l{mark}", length), d.bar(f"r{mark}", length)
    coupler = coupler_of(f"c{mark}", base)
    d.hinge(f"a{mark}", foot, left, th, **d.driven())
    d.hinge(f"b{mark}", other, right, th)
    d.hinge(f"e{mark}", f"{left}.tip", coupler, f"-{th}")
    d.pin(f"h{mark}", f"{right}.tip", f"{coupler}.tip")


def stacked(d: Draft) -> None:
    """A parallelogram on the coupler of another one; one of the two becomes flat, or each of them."""
    base = d.length("d")
    first = d.chance(0.5)
    for mark, goes in (("1", first), ("2", not first)):
        away = float(d.random.uniform(20.0, 70.0))
        if goes:
            d.planted(f"th{mark}", 0.0, away)
        else:
            d.parameters.append(Angle(f"th{mark}", away, low=0.5 * away, high=1.3 * away))
    d.ports["u"] = (base, 0, 0)
    length = d.length("L1")
    d.bar("l1", length), d.bar("r1", length), d.bar("c1", base)
    d.hinge("a1", "ground", "l1", "th1", **d.driven())
    d.hinge("b1", "ground.u", "r1", "th1")
    d.hinge("e1", "l1.tip", "c1", "-th1")
    d.pin("h1", "r1.tip", "c1.tip")
    _parallelogram(d, "2", "c1", "c1.tip", "th2", base, d.link)


def slider_crank(d: Draft) -> None:
    """Crank and rod of the same length, a slider at 2 L cos(th): flat at th = 90 deg."""
    has_rail = d.chance(0.5)
    if has_rail:
        t = d.planted("t", 1.0, -float(d.random.uniform(0.3, 0.7)), "1")
        th, twice, cosine = f"2*atan({t})", f"-4*atan({t})", _cosine(t)
    else:
        th, twice, cosine = d.planted("th", 90.0, -float(d.random.uniform(20.0, 60.0))), "-2*th", ""
    length = d.length()
    d.bar("crank", length)
    d.link("rod", length)
    d.bar("slider", 0.1)
    d.hinge("a", "ground", "crank", th, **d.driven())
    d.hinge("b", "crank.tip", "rod", twice)
    if has_rail:
        d.slide("rail", "ground", "slider", f"2*{length}*{cosine}")
        d.pin("h", "rod.tip", "slider")
        return
    d.hinge("c", "rod.tip", "slider", "th")
    d.close("h", "ground", "slider", d.one_of("prismatic", "cylindrical"))


def _cosine(t: str) -> str:
    """Of the angle 2 atan(t)."""
    return f"(1 - {t}^2)/(1 + {t}^2)"


def _sine(t: str) -> str:
    return f"2*{t}/(1 + {t}^2)"


def two_angles(d: Draft) -> None:
    """Crank at th = 2 atan(t), rod at -ps with r sin(th) = l sin(ps): flat only where both are 90 deg."""
    d.planted("t", 1.0, -float(d.random.uniform(0.3, 0.6)), "1")
    d.planted("s", 1.0, -float(d.random.uniform(0.3, 0.6)), "1")
    length = d.length("r")
    rod = f"({length}*{_sine('t')}/({_sine('s')}))"
    d.bar("crank", length), d.bar("rod", rod), d.bar("slider", 0.1)
    d.hinge("a", "ground", "crank", "2*atan(t)", **d.driven())
    d.hinge("b", "crank.tip", "rod", "-2*atan(t) - 2*atan(s)")
    d.slide("rail", "ground", "slider", f"{length}*{_cosine('t')} + {rod}*{_cosine('s')}")
    d.pin("h", "rod.tip", "slider")


def swinging_block(d: Draft) -> None:
    """A crank at 2 th on a pivot as far from a block as it is long; the rod has length 2 L sin(th)."""
    d.planted("th", 0.0, float(d.random.uniform(15.0, 55.0)))
    length = d.length()
    d.ports["u"] = (length, 0, 0)
    d.bar("crank", length), d.bar("block", 0.1), d.bar("rod", 0.3)
    d.hinge("a", "ground", "crank", "2*th", **d.driven())
    d.hinge("b", "crank.tip", "rod", "90*deg - th")
    d.hinge("c", "ground.u", "block", "90*deg + th")
    d.close("h", "block", "rod", d.one_of("prismatic", "cylindrical"))


def strut(d: Draft) -> None:
    """A flap at 4 atan(t) with a telescopic strut: a universal joint, a slide, a ball closes the loop.

    Flat where the strut has length zero, t = 0; or where it lies along the first axis of its joint.
    """
    length = d.length()
    d.ports["u"] = (length, 0, 0)
    d.bar("flap", length), d.bar("leg", 0.2), d.bar("rod", 0.2)
    universal: dict[str, Any] = {"name": "c", "parent": "ground.u", "child": "leg", "preload": (0, 0)}
    if d.chance(0.5):
        d.planted("t", 0.0, float(d.random.uniform(0.15, 0.5)), "1")
        universal |= {"axis1": Z, "axis2": (0.0, 1.0, 0.0), "position": ("90*deg + 2*atan(t)", 0.0)}
    else:
        lies = float(d.random.uniform(0.4, 0.5))
        d.planted("t", lies, d.one_of(-1, 1) * float(d.random.uniform(0.1, 0.2)), "1")
        turned = [*_turned("90*deg"), *_turned(f"2*atan({lies!r})")]
        universal |= {"axis1": (1.0, 0.0, 0.0), "axis2": Z, "orientation": turned}
        universal |= {"position": (0.0, f"2*atan(t) - 2*atan({lies!r})")}
    d.hinge("a", "ground", "flap", "4*atan(t)", **d.driven())
    d.joints.append(mbdlft.Universal(**universal))
    d.slide("b", "leg", "rod", f"2*{length}*{_sine('t')}")
    d.close("h", "flap.tip", "rod", "spherical")


def four_slides(d: Draft) -> None:
    """Slides along two directions and back again: flat where both are one."""
    be = d.planted("be", 0.0, float(d.random.uniform(20.0, 60.0)))
    first, second = d.length("p"), d.length("q")
    for name in ("a", "b", "c"):
        d.bar(name, 0.1)
    held = d.driven() | {"stiffness": 30.0}
    d.slide("s1", "ground", "a", first, **held)
    d.slide("s2", "a", "b", second, orientation=_turned(be), **held)
    d.slide("s3", "b", "c", f"-{first}", orientation=_turned(f"-{be}"))
    if d.chance(0.5):
        d.close("h", "ground", "d", "prismatic", orientation=_turned(be))
        d.bar("d", 0.1)
        d.joints.append(mbdlft.Fixed(name="weld", parent="c", child="d", axis=Z, position=be))
        return
    d.bar("e", 0.1)
    d.slide("s4", "c", "e", f"-{second}", orientation=_turned(be))
    d.close("h", "ground", "e", "fixed", orientation=_turned(be))


def two_rails(d: Draft) -> None:
    """A bar of length l sin(be) between sliders on rails with the angle be: flat where that is zero."""
    d.planted("t", 0.0, float(d.random.uniform(0.2, 0.45)), "1")
    corner = float(d.random.uniform(0.4, 0.7))  # tan(ga/2) of the corner on the first rail
    g: str | float = corner
    if d.count > 1 and d.chance(0.5):
        g = "g"
        d.parameters.append(Parameter(g, corner, percent=20))
    (sin_be, cos_be), (sin_ga, cos_ga) = ((f"({_sine(x)})", f"({_cosine(x)})") for x in ("t", f"{g}"))
    length = d.length()
    d.bar("s", 0.1), d.bar("e", 0.1), d.bar("rod", f"{length}*{sin_be}")
    d.slide("a", "ground", "s", f"{length}*({sin_be}*{cos_ga} + {cos_be}*{sin_ga})")
    d.slide("b", "ground", "e", f"{length}*{sin_ga}", orientation=_turned("2*atan(t)"))
    d.hinge("c", "s", "rod", f"180*deg - 2*atan({g})", **d.driven())
    d.pin("h", "rod.tip", "e")


def shafts(d: Draft) -> None:
    """Shafts at right angles in a universal joint: flat where an arm lies along shaft one."""
    d.planted("th", 0.0, d.one_of(-1, 1) * float(d.random.uniform(20.0, 70.0)))
    d.bar("one", 0.3), d.bar("two", 0.3)
    to_x, back = ([Rotation(axis=(0.0, 1.0, 0.0), angle=f"{turn}*deg")] for turn in (90, -90))
    d.hinge("a", "ground", "two", "th", **d.driven())
    d.hinge("b", "ground", "one", orientation=to_x)
    axes: dict[str, Any] = {"axis1": Z, "axis2": (1.0, 0.0, 0.0), "orientation": back}
    d.close("h", "one", "two", "universal", **axes)


def scissors(d: Draft) -> None:
    """Two bars crossed at their middle carry a platform on a slider: flat at th = 90 deg."""
    t = d.planted("t", 1.0, -float(d.random.uniform(0.3, 0.7)), "1")
    length, th = d.length(), f"2*atan({t})"
    reach = f"2*{length}*{_cosine(t)}"
    d.bar("up", f"2*{length}", middle=(length, 0, 0))
    d.bar("down", length, tail=(f"-{length}", 0, 0))
    for name in ("foot", "top", "head"):
        d.bar(name, 0.1)
    d.hinge("a", "ground", "up", th, **d.driven())
    d.hinge("b", "up.middle", "down", f"-4*atan({t})")
    d.slide("rail", "ground", "foot", reach)
    d.hinge("c", "up.tip", "top", f"-{th}")
    d.slide("groove", "top", "head", f"-{reach}")
    d.pin("h", "down.tip", "foot")
    d.pin("g", "down.tail", "head")


FAMILIES: tuple[Callable[[Draft], None], ...] = (
    shafts, two_rails, slider_crank, swinging_block, four_slides, parallelogram, two_angles, strut,
    stacked, scissors,
)  # fmt: skip


def drawn(seed: int, *, flat: bool) -> tuple[Scene, dict[str, float]]:
    """A loop of the family of the seed, and its flat position (in the units of the parameters)."""
    d, family = Draft(seed, flat=flat), FAMILIES[seed % len(FAMILIES)]
    family(d)
    return d.scene(f"{family.__name__} {seed}"), d.at


def rank(scene: Scene, point: dict[str, float]) -> int:
    """Of the constraints at a point, in maximal coordinates; rigid bodies only."""
    with flint.ctx.workprec(BITS):
        b = Bodies(scene, point)
        rows = [
            b.spread(link, row)
            for link in b.links
            for row in link.jacobian(b.motion(link.parent), b.motion(link.child))[len(link.laws) :]
        ]
    sizes = np.linalg.svd(np.array(rows).astype(float), compute_uv=False)
    return int(np.sum(sizes > _LOST * sizes[0]))


def attack(seed: int, folder: Path | None = None) -> str:
    """Linearize a loop with a flat position in its range (even seeds), or without (odd ones)."""
    flat = seed % 2 == 0
    scene, at = drawn(seed // 2, flat=flat)
    if not any(isinstance(body, Beam) for body in scene.bodies):
        random = np.random.default_rng(seed)
        points = [
            {p.name: float(random.uniform(p.low, p.high)) for p in scene.parameters}
            for _ in range(_SAMPLES)
        ]
        at_flat, *elsewhere = (rank(scene, point) for point in (points[0] | at, *points))
        assert len({*elsewhere}) == 1, f"ranks {elsewhere}"
        assert at_flat < elsewhere[0], f"rank {at_flat} at the flat position, {elsewhere[0]} elsewhere"
    try:
        known = mbdlft.to_lft(scene, search=0.0).certificate.well_posed
    except MbdlftError as error:
        check_message(error)
        known, why = f"refused: {type(error).__name__}", str(error)
    if not known.startswith("refused"):
        assert not (flat and known == "proved"), f"proved, with a flat position at {at} in the range"
        return f"{'flat' if flat else 'regular'}, {known}"
    where = [*(f"{name} =" for name in at), "singular position", "TrimError"]
    assert flat, f"refused without a flat position: {why}"
    assert any(word in why + known for word in where), f"refused for another reason: {why}"
    return f"flat, {known}"
