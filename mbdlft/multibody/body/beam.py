"""A straight beam along x, by finite elements with its parameters left in.

In s = x/L and the nodal coordinates w, ds dw/ds, ds^2 d2w/ds2 (ds = 1/n for n elements) the matrices
of bending are numbers times

    M = rho A L M0 (+ rho I/L M1),   K = E I/L^3 K0
    M0 = int N'N ds,   M1 = int dN'dN ds,   K0 = int ddN'ddN ds

with N the cubic (Hermite) or quintic shape functions of the elements; likewise axial (rho A L, E A/L) and
torsion (rho (Iy + Iz) L, G J/L), linear. Timoshenko elements (cubic, with `shear_coefficient` k) have

    K = E I/(L^3 (1 + phi)) (K0 + phi K1),   phi = 12 E I n^2/(k G A L^2)

They are the matrices of appendix B of the source in `tests/reference/flexible.py`.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import casadi as ca
import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from pydantic import Field, model_validator

from mbdlft.base.description import Expected, Name, Quantity, Text, Values
from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.base.signal import Freedom
from mbdlft.multibody.body.elastic import (
    Elastic,
    ElasticBody,
    Term,
    elastic_freedom,
    elastic_problem,
)
from mbdlft.multibody.body.rigid import newton_euler
from mbdlft.multibody.spatial import Coordinate

DEFORMATIONS = ("axial", "torsion", "bending_y", "bending_z")
SHAPES = ("cubic", "quintic")
_UNITS = {
    "length": "m",
    "density": "kg m^-3",
    "area": "m^2",
    "modulus": "Pa",
    "shear_modulus": "Pa",
    "I_y": "m^4",
    "I_z": "m^4",
    "torsion_constant": "m^4",
    "shear_coefficient": "1",
    "mass_damping": "s^-1",
    "stiffness_damping": "s",
}


class Field1D(NamedTuple):
    """Numbers of one deformation on s in [0, 1], clamped at s = 0.

    mass, rotary, stiffness, shear (n, n); moment0, moment1 (n,): integrals of N and s N.
    """

    mass: NDArray[np.float64]
    rotary: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    shear: NDArray[np.float64]
    moment0: NDArray[np.float64]
    moment1: NDArray[np.float64]


class Beam(ElasticBody):
    """A uniform beam from the origin along x: SI units, moments of area about y and z.

    `bending_y` moves along y (I_z), `bending_z` along z (I_y). `deformations` are those that the
    model has; what they do not use may be left out. `stations` names nodes, 1 to `elements`, as
    ports; ``tip`` is the last one. Damping is `mass_damping` M + `stiffness_damping` K.
    """

    kind: ClassVar[str] = "beam"

    length: Quantity
    density: Quantity
    area: Quantity
    modulus: Quantity | None = None
    shear_modulus: Quantity | None = None
    I_y: Quantity | None = None
    I_z: Quantity | None = None
    torsion_constant: Quantity | None = None
    shear_coefficient: Quantity | None = None
    mass_damping: Quantity = 0.0
    stiffness_damping: Quantity = 0.0
    rotary_inertia: bool = False
    elements: Annotated[int, Field(ge=1, le=200, strict=True)] = 4
    shape_functions: Text = "cubic"
    deformations: tuple[Text, ...] = DEFORMATIONS
    stations: dict[Name, Annotated[int, Field(ge=1, strict=True)]] = {}

    @model_validator(mode="after")
    def _data_are_complete(self) -> Self:
        if self.shape_functions not in SHAPES:
            raise SceneError(unknown_name("shape_functions", self.shape_functions, SHAPES))
        if not self.deformations or len(set(self.deformations)) < len(self.deformations):
            raise SceneError(
                f"deformations: expected some of {', '.join(DEFORMATIONS)}, each once."
            )
        for name in self.deformations:
            if name not in DEFORMATIONS:
                raise SceneError(unknown_name("deformation", name, DEFORMATIONS))
            for key in _NEEDED[name] + (("shear_modulus",) if self._has_shear(name) else ()):
                if getattr(self, key) is None:
                    raise SceneError(f"{key!r} is missing; the deformation {name!r} needs it.")
        if self.shear_coefficient is not None and self.shape_functions != "cubic":
            raise SceneError("shear_coefficient: shear is for cubic shape functions only.")
        if self.ports:
            raise SceneError("a beam has 'tip' and `stations` (names of nodes) in place of ports.")
        for name, node in self.stations.items():
            if node > self.elements or name in ("tip", "origin"):
                raise SceneError(
                    f"stations.{name}: expected a new name and a node from 1 to {self.elements}, got "
                    f"{node}."
                )
        return self

    def _has_shear(self, deformation: str) -> bool:
        return deformation.startswith("bending") and self.shear_coefficient is not None

    def own_quantities(self) -> dict[str, Expected]:
        return {
            key: Expected(given, unit)
            for key, unit in _UNITS.items()
            if (given := getattr(self, key)) is not None
        }

    def port_names(self) -> tuple[str, ...]:
        return ("origin", "tip", *self.stations)

    def elastic_ports(self) -> tuple[str, ...]:
        return ("tip", *self.stations)

    def port_position(self, port: str, values: Values) -> ca.SX:
        if port == "origin":
            return ca.SX(3, 1)
        return ca.sparsify(ca.vertcat(ca.SX(self._at(port) * values["length"]), ca.SX(2, 1)))

    def _node(self, port: str) -> int:
        return self.elements if port == "tip" else self.stations[port]

    def _at(self, port: str) -> float:
        return self._node(port) / self.elements

    def _fields(self) -> list[tuple[str, Field1D]]:
        return [
            (name, field_numbers(name, self.shape_functions, self.elements))
            for name in self._order()
        ]

    def _order(self) -> list[str]:
        return [name for name in DEFORMATIONS if name in self.deformations]

    def freedoms(self) -> tuple[Freedom, ...]:
        found = []
        for name, numbers in self._fields():
            # displacements, slopes and curvatures times powers of the element's length
            turns = name == "torsion"
            unit, effort = ("rad", "N m") if turns else ("m", "N")
            for k in range(len(numbers.mass)):
                found.append(elastic_freedom(f"{name}.{k + 1}", unit, effort, turns=turns))
        return tuple(found)

    def _blocks(self) -> list[tuple[str, Field1D, slice]]:
        """Deformations with their numbers and their place among the coordinates."""
        found, k = [], 0
        for name, numbers in self._fields():
            found.append((name, numbers, slice(k, k := k + len(numbers.mass))))
        return found

    def elastic(self, values: Values) -> Elastic:
        n = len(self.freedoms())
        mass: list[Term] = []
        stiffness: list[Term] = []
        participation: list[Term] = []
        L, rho, A = (values[key] for key in ("length", "density", "area"))
        for name, numbers, part in self._blocks():
            line = rho * self._polar(values) * L if name == "torsion" else rho * A * L
            mass.append(Term(line, _square(n, part, numbers.mass)))
            if name.startswith("bending") and self.rotary_inertia:
                mass.append(Term(rho * values[_AREA[name]] / L, _square(n, part, numbers.rotary)))
            stiffness += self._stiffness(name, numbers, n, part, values)
            participation += self._participation(name, numbers, part, line, L)
            if name.startswith("bending") and self.rotary_inertia:
                slope = _ROW[name][1] * _slopes(self.shape_functions, self.elements)
                factor = rho * values[_AREA[name]]
                participation.append(Term(factor, _row(n, part, _TURNED[name], slope)))
        damping = [Term(values["mass_damping"] * factor, matrix) for factor, matrix in mass]
        damping += [
            Term(values["stiffness_damping"] * factor, matrix) for factor, matrix in stiffness
        ]
        given = {"mass_damping": self.mass_damping, "stiffness_damping": self.stiffness_damping}
        damped = any(value != 0.0 for value in given.values())
        return Elastic(mass, damping if damped else [], stiffness, participation)

    def efforts(self, motion: ca.SX, values: Values, at: Coordinate) -> ca.SX:
        """As of any elastic body, with M (qddot + a qdot) + K (q + b qdot): M and K are met once."""
        q = at.q + values["stiffness_damping"] * at.v
        a = at.a + values["mass_damping"] * at.v
        return ca.SX(super().efforts(motion, values, Coordinate(q, ca.SX(*at.v.shape), a)))

    def _participation(
        self, name: str, numbers: Field1D, part: slice, line: Any, length: Any
    ) -> list[Term]:
        """Participation factors of one deformation for a mass `line` in all (kg), or kg m^2."""
        n, (row, sign) = len(self.freedoms()), _ROW[name]
        found = [Term(line, _row(n, part, row, numbers.moment0))]
        if name.startswith("bending"):
            found.append(Term(length * line, _row(n, part, _TURNED[name], sign * numbers.moment1)))
        return found

    def _placed(self, part: slice, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
        return _square(len(self.freedoms()), part, matrix)

    def _position(self, deformation: str, node: int) -> int:
        """Of the displacement of a node among the coordinates of a deformation."""
        return _first(deformation, self.shape_functions, node)

    def _stiffness(
        self, name: str, numbers: Field1D, n: int, part: slice, values: Values
    ) -> list[Term]:
        L = values["length"]
        if name == "axial":
            factor = values["modulus"] * values["area"] / L
            return [Term(factor, _square(n, part, numbers.stiffness))]
        if name == "torsion":
            factor = values["shear_modulus"] * values["torsion_constant"] / L
            return [Term(factor, _square(n, part, numbers.stiffness))]
        bending = values["modulus"] * values[_AREA[name]]
        factor = bending / (L * L * L)
        if not self._has_shear(name):
            return [Term(factor, _square(n, part, numbers.stiffness))]
        shear = values["shear_coefficient"] * values["shear_modulus"] * values["area"]
        phi = 12.0 * self.elements**2 * bending / (shear * L * L)
        return [
            Term(factor / (1.0 + phi), _square(n, part, numbers.stiffness)),
            Term(factor * phi / (1.0 + phi), _square(n, part, numbers.shear)),
        ]

    def _polar(self, values: Values) -> Any:
        return values["I_y"] + values["I_z"]

    def shapes(self, port: str, values: Values) -> Sequence[Term]:
        n, node = len(self.freedoms()), self._node(port)
        plain, turned = np.zeros((6, n)), np.zeros((6, n))
        for name, _, part in self._blocks():
            row, sign = _ROW[name]
            first = part.start + _first(name, self.shape_functions, node)
            plain[row, first] = 1.0
            if name.startswith("bending"):
                turned[_TURNED[name], first + 1] = sign * self.elements
        found = [Term(1.0, plain)]
        if np.any(turned):
            found.append(Term(1.0 / values["length"], turned))
        return found

    def total_mass(self, values: Values) -> ca.SX:
        return ca.SX(values["density"] * values["area"] * values["length"])

    def rigid_wrench(self, motion: ca.SX, values: Values) -> ca.SX:
        L, rho, A = (values[key] for key in ("length", "density", "area"))
        mass = rho * A * L
        across = mass * (L * L) / 3.0
        polar = rho * self._polar(values) * L if "torsion" in self.deformations else 0.0
        y, z = across, across
        if self.rotary_inertia:
            y = y + rho * values["I_y"] * L if "bending_z" in self.deformations else y
            z = z + rho * values["I_z"] * L if "bending_y" in self.deformations else z
        inertia = ca.diag(ca.vertcat(ca.SX(polar), y, z))
        center = ca.vertcat(ca.SX(0.5 * L), ca.SX(2, 1))
        return ca.SX(newton_euler()(motion, mass, ca.SX(3, 1), center, inertia))

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        for key, value in values.items():
            lowest = float(np.min(value))
            if lowest < 0.0 or (lowest == 0.0 and "damping" not in key):
                return f"{key} is not positive in the range: {lowest:g} {_UNITS[key]}."
        return elastic_problem(self, values, self.rigid_mass(values))

    def rigid_mass(self, values: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Mass matrices (samples, 6, 6) of the undeformed body about its origin."""
        L, mass = values["length"], values["density"] * values["area"] * values["length"]
        rigid = np.zeros((len(mass), 6, 6))
        rigid[:, [0, 1, 2], [0, 1, 2]] = mass[:, None]
        rigid[:, 1, 5] = rigid[:, 5, 1] = 0.5 * mass * L
        rigid[:, 2, 4] = rigid[:, 4, 2] = -0.5 * mass * L
        rigid[:, 4, 4] = rigid[:, 5, 5] = mass * L**2 / 3.0
        if self.rotary_inertia:
            for key, k, name in (("I_y", 4, "bending_z"), ("I_z", 5, "bending_y")):
                if name in self.deformations:
                    rigid[:, k, k] += values["density"] * values[key] * L
        if "torsion" in self.deformations:
            rigid[:, 3, 3] = values["density"] * self._polar(values) * L
        return rigid


_NEEDED: dict[str, tuple[str, ...]] = {
    "axial": ("modulus",),
    "torsion": ("shear_modulus", "torsion_constant", "I_y", "I_z"),
    "bending_y": ("modulus", "I_z"),
    "bending_z": ("modulus", "I_y"),
}
_AREA = {"bending_y": "I_z", "bending_z": "I_y"}
_ROW = {"axial": (0, 1.0), "torsion": (3, 1.0), "bending_y": (1, 1.0), "bending_z": (2, -1.0)}
_TURNED = {"bending_y": 5, "bending_z": 4}  # th_z = dv/dx, th_y = -dw/dx


def _square(n: int, part: slice, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    found = np.zeros((n, n))
    found[part, part] = matrix
    return found


def _row(n: int, part: slice, row: int, entries: NDArray[np.float64]) -> NDArray[np.float64]:
    found = np.zeros((6, n))
    found[row, part] = entries
    return found


def _per_node(name: str, functions: str) -> int:
    """Coordinates of one node."""
    if not name.startswith("bending"):
        return 1
    return 2 if functions == "cubic" else 3


def _clamped(name: str, functions: str) -> int:
    """Coordinates of the first node that the clamp holds: all but its curvature."""
    return min(_per_node(name, functions), 2)


def _first(name: str, functions: str, node: int) -> int:
    """Position of the displacement of a node among the coordinates of one deformation."""
    return node * _per_node(name, functions) - _clamped(name, functions)


@cache
def field_numbers(
    name: str, functions: str, elements: int, first: int = 0, last: int | None = None
) -> Field1D:
    """Assembled numbers of one deformation, of the elements between two nodes."""
    bending = name.startswith("bending")
    order = 2 if bending else 1
    ds = 1.0 / elements
    shapes = element_shapes(name, functions, ds)
    count = _per_node(name, functions) * (elements + 1)
    total = {key: np.zeros((count, count)) for key in ("mass", "rotary", "stiffness", "shear")}
    moments = np.zeros((2, count))
    local = {
        "mass": _products(shapes, 0, ds),
        "rotary": _products(shapes, 1, ds),
        "stiffness": _products(shapes, order, ds),
        "shear": _shear(ds) if bending and functions == "cubic" else np.zeros((len(shapes),) * 2),
    }
    for element in range(first, elements if last is None else last):
        at = slice(start := element * len(shapes) // 2, start + len(shapes))
        for key, matrix in local.items():
            total[key][at, at] += matrix
        s = Polynomial([element * ds, 1.0])
        for k, weight in enumerate((Polynomial([1.0]), s)):
            moments[k, at] += [_integral(weight * shape, ds) for shape in shapes]
    free = slice(_clamped(name, functions), None)
    matrices = {key: matrix[free, free] for key, matrix in total.items()}
    return Field1D(**matrices, moment0=moments[0, free], moment1=moments[1, free])


@cache
def _slopes(functions: str, elements: int) -> NDArray[np.float64]:
    """Integrals of dN/ds of bending: only the displacement of the tip has one."""
    per_node = _per_node("bending_y", functions)
    found = np.zeros(per_node * (elements + 1) - _clamped("bending_y", functions))
    found[_first("bending_y", functions, elements)] = 1.0
    return found


def element_shapes(name: str, functions: str, ds: float) -> tuple[Polynomial, ...]:
    """Shape functions of one deformation on an element of length ds."""
    return _element(_per_node(name, functions), ds)


@cache
def _element(per_node: int, ds: float) -> tuple[Polynomial, ...]:
    """Shape functions on [0, ds] for N, ds N' (and ds^2 N'') at both ends."""
    count = 2 * per_node
    rows = []
    for x in (0.0, ds):
        for derivative in range(per_node):
            monomials = [Polynomial.basis(k).deriv(derivative) for k in range(count)]
            rows.append([ds**derivative * monomial(x) for monomial in monomials])
    return tuple(Polynomial(column) for column in np.linalg.inv(np.array(rows)).T)


def _products(shapes: Sequence[Polynomial], order: int, ds: float) -> NDArray[np.float64]:
    """Integrals of products of derivatives."""
    derivatives = [shape.deriv(order) if order else shape for shape in shapes]
    found = np.array([[_integral(a * b, ds) for b in derivatives] for a in derivatives])
    return np.asarray(0.5 * (found + found.T))


def _shear(ds: float) -> NDArray[np.float64]:
    """K1: what shear adds to the stiffness of slopes."""
    found = np.zeros((4, 4))
    found[np.ix_([1, 3], [1, 3])] = [[1.0, -1.0], [-1.0, 1.0]]
    return found / ds**3


_integral: Callable[[Polynomial, float], float] = lambda p, ds: float(p.integ()(ds))  # noqa: E731
