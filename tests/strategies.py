"""Random scenes: a seed gives a physical tree with parameters of all kinds; edge cases by turn."""

from itertools import product
from typing import NamedTuple

import numpy as np
from hypothesis import settings

import mbdlft
from mbdlft.base.expression import evaluate, names, parse
from mbdlft.base.unit import parse_unit

EDGES = (
    "none",
    "zero gravity",
    "mass ratio",
    "angle near zero",
    "angle near straight",
    "no parameters",
    "unused parameter",
    "planar",
    "wide angle",
    "accelerated",
)  # the edge of a seed is that of its last digit
MOST_JOINTS = 6

# units that a parameter of each kind may be given in
MASS, LENGTH, INERTIA = ("kg", "g", "t"), ("m", "mm", "cm"), ("kg m^2", "kg cm^2", "N m s^2")
TURN_STIFFNESS, SLIDE_STIFFNESS = ("N m/rad", "N m/deg", "N m"), ("N/m", "N/mm", "kN/m")
TURN_DAMPING, SLIDE_DAMPING = ("N m s/rad", "N mm s/rad"), ("N s/m", "kg/s")
ACCELERATION = ("m/s^2", "mm/s^2")
FORCE, TORQUE = ("N", "kN", "kg m s^-2"), ("N m", "N mm")
_LETTERS = {
    MASS: "m",
    LENGTH: "L",
    INERTIA: "J",
    TURN_STIFFNESS: "k",
    SLIDE_STIFFNESS: "k",
    TURN_DAMPING: "d",
    SLIDE_DAMPING: "d",
    ACCELERATION: "g",
    FORCE: "F",
    TORQUE: "T",
}


# for laws that take long: a third of the examples of the profile
fewer = settings(max_examples=settings().max_examples // 3)


class Drawn(NamedTuple):
    """A number or expression, and the bounds of its value (SI)."""

    source: float | str
    low: float
    high: float

    @property
    def size(self) -> float:
        return max(abs(self.low), abs(self.high))


def random_scene(
    seed: int, joints: int | None = None, parameters: int | None = None, edge: str | None = None
) -> mbdlft.Scene:
    """A random scene; `joints` that move (1 to 6), most `parameters`, and `edge` are drawn if not given.

    The mass matrix is positive definite and the inertias are physical over the whole range.
    """
    return Draft(seed, joints, parameters, edge or EDGES[seed % len(EDGES)]).scene()


class Draft:
    """A random scene in the making."""

    def __init__(self, seed: int, joints: int | None, parameters: int | None, edge: str) -> None:
        self.random = np.random.default_rng(seed)
        self.seed, self.edge = seed, edge
        self.count = joints or int(self.random.integers(1, MOST_JOINTS + 1, 2).max())
        most = int(self.random.integers(1, 7 if self.count <= 4 else 5))
        self.most = most if parameters is None else parameters
        if edge == "no parameters":
            self.most = 0
        self.parameters: list[mbdlft.Parameter] = []
        self.constants: dict[str, float | mbdlft.Constant] = {"half": 0.5}
        self.of_kind: dict[tuple[str, ...], list[str]] = {}
        self.bodies: list[mbdlft.RigidBody | mbdlft.PointMass | mbdlft.Ground] = []
        self.joints: list[mbdlft.Revolute | mbdlft.Prismatic | mbdlft.Fixed] = []

    # choices ---------------------------------------------------------------------------------

    def chance(self, probability: float) -> bool:
        return bool(self.random.random() < probability)

    def number(self, low: float, high: float) -> float:
        return float(self.random.uniform(low, high))

    def one_of(self, *items):
        return items[int(self.random.integers(len(items)))]

    # quantities ------------------------------------------------------------------------------

    @property
    def left(self) -> int:
        """How many more parameters there may be."""
        return self.most - len(self.parameters)

    def quantity(
        self,
        value: float,
        kind: tuple[str, ...],
        spread: float = 0.3,
        rate: float = 0.25,
        *,
        reuse: bool = True,
    ) -> Drawn:
        """The nominal value (SI), as a number or as an expression of new or known parameters."""
        if value == 0.0 or not self.chance(rate):
            return Drawn(value, value, value)
        known = self.of_kind.get(kind, [])
        if reuse and known and self.chance(0.4):
            name = self.one_of(*known)
            parameter = next(p for p in self.parameters if p.name == name)
            nominal = parameter.nominal * parse_unit(parameter.unit).factor
            return self._bounded(f"{value / nominal!r}*{name}")
        if self.left < 1:
            return Drawn(value, value, value)
        forms = [self._plain, self._affine, self._offset, self._share, self._ratio, self._square]
        return self._bounded(self.one_of(*forms)(value, kind, spread))

    def _bounded(self, source: str) -> Drawn:
        """Bounds of an expression that is monotonic in each parameter."""
        used = [p for p in self.parameters if p.name in names(parse(source))]
        values = {
            name: c if isinstance(c, float) else c.value * parse_unit(c.unit).factor
            for name, c in self.constants.items()
        }
        ends = []
        for sides in product((0, 1), repeat=len(used)):
            for p, side in zip(used, sides, strict=True):
                values[p.name] = (p.low, p.high)[side] * parse_unit(p.unit).factor
            ends.append(float(evaluate(parse(source), values)))
        return Drawn(source, min(ends), max(ends))

    def _is_in_units(self, source: str) -> bool:
        """Whether a name gives an expression a unit; else its numbers have that of its place."""
        units = {p.name: p.unit for p in self.parameters}
        units |= {n: c.unit for n, c in self.constants.items() if not isinstance(c, float)}
        return any(units.get(name, "1") not in ("1", "%") for name in names(parse(source)))

    def _new(self, nominal: float, unit: str, letter: str, spread: float) -> str:
        """Name of a new parameter with a nominal value in `unit` and a relative half width."""
        name = f"{letter}{len(self.parameters) + 1}"
        half = abs(nominal) * spread * self.number(0.3, 1.0)
        role = self.one_of("uncertain", "scheduled", "design")
        way = self.one_of("percent", "low and high", "plus", "plus and minus")
        if way == "percent":
            span = {"percent": 100.0 * half / abs(nominal)}
        elif way == "low and high":
            span = {"low": nominal - half * self.number(0.1, 1.0), "high": nominal + half}
        elif way == "plus":
            span = {"plus": half}
        else:
            span = {"plus": half * self.number(0.1, 1.0), "minus": half}
        self.parameters.append(mbdlft.Parameter(name, nominal, unit=unit, role=role, **span))
        return name

    def _measured(self, value: float, kind: tuple[str, ...], spread: float) -> str:
        """Name of a new parameter with a nominal value (SI), in a unit of its kind."""
        unit = self.one_of(*kind)
        name = self._new(value / parse_unit(unit).factor, unit, _LETTERS[kind], spread)
        self.of_kind.setdefault(kind, []).append(name)
        return name

    def _plain(self, value: float, kind: tuple[str, ...], spread: float) -> str:
        return self._measured(value, kind, spread)

    def _affine(self, value: float, kind: tuple[str, ...], spread: float) -> str:
        return f"2*{self._measured(0.4 * value, kind, spread)} + {0.2 * value!r}"

    def _offset(self, value: float, kind: tuple[str, ...], spread: float) -> str:
        name = self._measured(0.5 * value, kind, spread)
        return f"sqrt(9)*{name} - half*{value!r}"

    def _share(self, value: float, kind: tuple[str, ...], spread: float) -> str:
        """rho*L, where L is a constant with a unit or another parameter."""
        whole = self.number(1.2, 3.0) * value
        if self.left >= 2 and self.chance(0.5):
            length = self._measured(whole, kind, 0.5 * spread)
        else:
            length, unit = f"c{len(self.constants)}", self.one_of(*kind)
            self.constants[length] = mbdlft.Constant(value=whole / parse_unit(unit).factor, unit=unit)
        unit = self.one_of("1", "%")
        rho = self._new(value / whole / parse_unit(unit).factor, unit, "rho", 0.5 * spread)
        return f"{rho}*{length}"

    def _ratio(self, value: float, kind: tuple[str, ...], spread: float) -> str:
        nominal = self.number(0.5, 2.0)
        name = self._new(nominal, "1", "r", 0.5 * spread)
        return f"{value * (1.0 + nominal)!r}/(1 + {name})"

    def _square(self, value: float, kind: tuple[str, ...], spread: float) -> str:
        nominal = self.number(0.5, 2.0)
        name = self._new(nominal, "1", "s", 0.5 * spread)
        return f"{value / nominal**2!r}*{name}^2"

    def vector(self, size: float) -> tuple[Drawn, Drawn, Drawn]:
        """A position (m), along an axis or anywhere."""
        values = self.random.uniform(-size, size, 3)
        if self.chance(0.5):
            values = values * (np.arange(3) == self.random.integers(3))
        x, y, z = (self.quantity(float(value), LENGTH) for value in values)
        return x, y, z

    def axis(self) -> tuple[float, float, float]:
        """A direction, not normalized: along a coordinate axis or skew."""
        if self.edge == "planar":
            return (1.0, 0.0, 0.0)
        if self.chance(0.6):
            values = self.one_of(-2.0, 1.0) * (np.arange(3) == self.random.integers(3))
        else:
            values = self.random.normal(size=3)
        x, y, z = (float(value) for value in values)
        return (x, y, z)

    def angle(self, *, forced: bool = False) -> float | str:
        """The position of a revolute or fixed joint: a number or an expression of angles (rad)."""
        known = [p.name for p in self.parameters if p.is_angle]
        if known and self.chance(0.2):
            return self.one_of("-{}", "2*{}", "{} - 0.3", "90*deg + {}").format(self.one_of(*known))
        if self.left and len(known) < 2 and (forced or self.chance(0.35)):
            name = self._new_angle()
            others = [f"{name} - {other}" for other in known]
            return self.one_of(name, name, f"pi/2 - {name}", f"{name} + 0.4", *others)
        near = {"angle near zero": (0.0, 1e-9), "angle near straight": (np.pi, np.pi - 1e-7)}
        if self.edge in near and self.chance(0.5):
            return float(self.one_of(*near[self.edge]))
        return self.one_of(0.0, np.pi / 2.0, "pi", "-30*deg", self.number(-3.0, 3.0))

    def _new_angle(self) -> str:
        """Name of a new angle; everything below is in degrees."""
        name = f"theta{len(self.parameters) + 1}"
        substitution = self.one_of("half-angle", "half-angle", "quarter-angle")
        reach = 150.0 if substitution == "half-angle" else 250.0
        nominal = self.one_of(0.0, 90.0, self.number(-180.0, 180.0))
        plus, minus = self.number(5.0, 50.0), self.number(5.0, 50.0)
        reference = self.one_of(None, None, 0.0, nominal + self.number(-60.0, 60.0))
        if self.edge == "angle near zero":
            nominal, reference = self.one_of(0.0, 1e-6, -1.0), None
        elif self.edge == "angle near straight":
            nominal, reference = self.one_of((180.0, None), (179.0, 178.0), (120.0, 0.0))
            plus = 55.0 if reference == 0.0 else plus
            reach = 176.0
        elif self.edge == "wide angle":
            plus = minus = 150.0 if substitution == "half-angle" else 240.0
            reference, reach = None, 300.0
        center = nominal if reference is None else reference
        if max(abs(nominal + plus - center), abs(nominal - minus - center)) > reach:
            reference = None
        factor, unit = self.one_of((1.0, "deg"), (np.pi / 180.0, "rad"))
        self.parameters.append(
            mbdlft.Angle(
                name,
                nominal * factor,
                plus=plus * factor,
                minus=minus * factor,
                unit=unit,
                substitution=substitution,
                reference=None if reference is None else reference * factor,
            )
        )
        return name

    # bodies ----------------------------------------------------------------------------------

    def ports(self) -> dict[str, tuple[Drawn, Drawn, Drawn]]:
        return {name: self.vector(0.8) for name in ("tip", "side")[: self.random.integers(1, 3)]}

    def body(self, name: str) -> None:
        value = self.number(0.5, 5.0)
        if self.edge == "mass ratio":
            value *= self.one_of(1e-3, 1.0, 1e3) if self.bodies else 1e3
            value *= 1e-6 if len(self.bodies) == 1 else 1.0
        mass, ports = self.quantity(value, MASS, rate=0.4), self.ports()
        sources = {port: _sources(position) for port, position in ports.items()}
        if self.chance(0.2):
            self.bodies.append(mbdlft.PointMass(name=name, mass=mass.source, ports=sources))
            return
        center = self.vector(0.4)
        about = self.one_of("center_of_mass", "center_of_mass", "origin", *ports)
        self.bodies.append(
            mbdlft.RigidBody(
                name=name,
                mass=mass.source,
                center_of_mass=_sources(center),
                inertia=self.inertia(value, mass, center, about, ports.get(about)),
                ports=sources,
            )
        )

    def inertia(
        self,
        value: float,
        mass: Drawn,
        center: tuple[Drawn, Drawn, Drawn],
        about: str,
        point: tuple[Drawn, Drawn, Drawn] | None,
    ) -> mbdlft.Inertia:
        """J = tr(P) I - P with a second moment P that stays positive about the center of mass."""
        axes, _ = np.linalg.qr(self.random.normal(size=(3, 3)))
        moments = value * self.number(0.05, 0.3) ** 2 * self.random.uniform(0.3, 1.0, 3)
        second = (axes * moments) @ axes.T
        if about != "center_of_mass":
            farthest = [c.size + (point[k].size if point else 0.0) for k, c in enumerate(center)]
            second += mass.high * float(np.dot(farthest, farthest)) * np.eye(3)
        matrix = np.trace(second) * np.eye(3) - second
        entries = {
            name: float(matrix[i, j])
            for name, i, j in (
                ("xx", 0, 0),
                ("yy", 1, 1),
                ("zz", 2, 2),
                ("xy", 0, 1),
                ("xz", 0, 2),
                ("yz", 1, 2),
            )
        }
        if self.edge == "planar":
            entries = {"xx": entries["xx"]}
        if about == "center_of_mass" and isinstance(mass.source, str) and self.chance(0.3):
            unit = " [m^2]" if self._is_in_units(mass.source) else ""
            with_mass = {name: f"{J / value!r}{unit}*({mass.source})" for name, J in entries.items()}
            return mbdlft.Inertia(**with_mass, about=about)
        # six entries that move by less than a fifth of the smallest moment leave P positive
        drawn = {
            name: self.quantity(J, INERTIA, min(0.3, 0.15 * min(moments) / abs(J)), 0.06, reuse=False)
            for name, J in entries.items()
        }
        return mbdlft.Inertia(**{name: item.source for name, item in drawn.items()}, about=about)

    # joints ----------------------------------------------------------------------------------

    def ends(self, child: str) -> dict[str, str]:
        """Parent and child of a joint to the last body: any earlier body, any port."""
        earlier = [body for body in self.bodies[:-1] if body.name != "ground"]
        parent = "ground"
        if earlier and not self.chance(0.2):
            body = self.one_of(*earlier[-2:], *earlier[-2:], *earlier)
            parent = self.one_of(body.name, *(f"{body.name}.{p}" for p in body.port_names()))
        elif self.bodies[0].name == "ground" and self.chance(0.5):
            parent = "ground.base"
        if self.chance(0.3):
            child = f"{child}.{self.one_of(*self.bodies[-1].port_names())}"
        return {"parent": parent, "child": child}

    def strength(self, value: float, kind: tuple[str, ...]) -> float | str:
        """A stiffness, damping or actuator inertia; often zero."""
        return self.quantity(value if self.chance(0.4) else 0.0, kind, rate=0.3).source

    def joint(self, name: str, child: str, *, moves: bool, first: bool) -> None:
        ends = self.ends(child)
        if not moves:
            fixed = mbdlft.Fixed(name=name, **ends, axis=self.axis(), position=self.angle())
            self.joints.append(fixed)
            return
        if self.chance(0.65) or (first and "angle" in self.edge):
            inertia = self.strength(self.number(0.01, 0.5), INERTIA)
            if isinstance(self.bodies[-1], mbdlft.PointMass) and inertia == 0.0:
                inertia = 0.1  # a point mass does not resist a rotation about itself
            self.joints.append(
                mbdlft.Revolute(
                    name=name,
                    **ends,
                    axis=self.axis(),
                    position=self.angle(forced=first and "angle" in self.edge),
                    stiffness=self.strength(self.number(1.0, 50.0), TURN_STIFFNESS),
                    damping=self.strength(self.number(0.1, 2.0), TURN_DAMPING),
                    actuator_inertia=inertia,
                )
            )
            return
        axis = self.axis()
        if self.edge == "planar":
            axis = (0.0, *self.random.normal(size=2).tolist())
        self.joints.append(
            mbdlft.Prismatic(
                name=name,
                **ends,
                axis=axis,
                position=self.quantity(self.number(-0.5, 0.5), LENGTH, rate=0.3).source,
                stiffness=self.strength(self.number(10.0, 500.0), SLIDE_STIFFNESS),
                damping=self.strength(self.number(1.0, 20.0), SLIDE_DAMPING),
                actuator_inertia=self.strength(self.number(0.1, 2.0), MASS),
            )
        )

    # the scene -------------------------------------------------------------------------------

    def acceleration(self) -> tuple[float | str, float | str, float | str]:
        """A uniform acceleration (m/s^2), vertical or anywhere."""
        values = self.random.uniform(-10.0, 10.0, 3)
        if self.chance(0.5):
            values = np.array([0.0, 0.0, -9.81])
        x, y, z = (self.quantity(float(value), ACCELERATION).source for value in values)
        return (x, y, z)

    def signals(self) -> dict[str, tuple[str, ...] | None]:
        """The default signals, or all of them in any order."""
        if self.chance(0.2):
            return {"inputs": None, "outputs": None}
        freedoms = [(joint.name, freedom) for joint in self.joints for freedom in joint.freedoms]
        efforts = [f"{name}.{freedom.effort.name}" for name, freedom in freedoms]
        measures = [f"{name}.{m.name}" for name, freedom in freedoms for m in freedom.measures]
        return {
            "inputs": tuple(map(str, self.random.permutation(efforts))),
            "outputs": tuple(map(str, self.random.permutation(measures))),
        }

    def scene(self) -> mbdlft.Scene:
        if self.chance(0.4):
            self.bodies.append(mbdlft.Ground(ports={"base": _sources(self.vector(0.5))}))
        moving = 0
        while moving < self.count:
            k = len(self.joints) + 1
            moves = not self.chance(0.2)
            self.body(f"b{k}")
            self.joint(f"j{k}", f"b{k}", moves=moves, first=moves and moving == 0)
            moving += moves
        zero = (0.0, 0.0, 0.0)
        gravity = zero if self.edge == "zero gravity" else self.acceleration()
        accelerated = self.edge == "accelerated" or (self.edge == "none" and self.chance(0.3))
        acceleration = self.acceleration() if accelerated else zero
        if self.edge == "unused parameter":
            self.parameters.append(mbdlft.Parameter("unused", 2.0, percent=10))
        return mbdlft.Scene(
            name=f"random {self.seed}",
            gravity=gravity,
            acceleration=acceleration,
            constants=self.constants,
            parameters=tuple(self.parameters),
            bodies=tuple(self.bodies),
            joints=tuple(self.joints),
            **self.signals(),
        )


def _sources(vector: tuple[Drawn, Drawn, Drawn]) -> tuple[float | str, float | str, float | str]:
    x, y, z = (entry.source for entry in vector)
    return (x, y, z)
