"""A straight beam along x, by finite elements whose matrices keep the parameters.

The matrices of a deformation are sums of terms: an expression of the parameters times a matrix of
numbers. With s = x/L, the displacement w(s) = N(s) q and the turn t(s) = T(s) q, which is L times the
rotation of the section, bending has

    M = rho A L int N'N ds (+ rho I/L int T'T ds)
    K = E I/L^3 int dT'dT ds (+ k G A/L int (dN - T)'(dN - T) ds)

Without the `shear_coefficient` k, T = dN/ds. With it (Timoshenko's beam), w has degree 4 and t degree 3
on each element, so dw/ds - t can be that of any linear moment and nothing locks; the matrices stay
polynomials in E, G, rho, I and 1/L. Elements with two coordinates at each node (Friedman, Kosmatka 1993)
have powers of 1/(1 + 12 E I n^2/(k G A L^2)) instead, and need four times as many coordinates.

The expressions of an axial deformation are rho A L and E A/L, those of torsion rho (Iy + Iz) L and G J/L.
The code has the area first, then density or modulus, then lengths. Products become channels from the
right, and M and K of a row share what stands on the left of both: frames of three beams with four
parameters have 410 repetitions in place of 460 (bound 340), and chains of elements lose two digits less.
Shape functions and loads are in `beam_elements`. Source: appendix B of the two-port models in
`tests/reference/flexible.py` for beams without shear.

The exact frequencies of bending without shear and rotary inertia are z^2 (E I/(rho A))^(1/2)/L^2, where
cos z cosh z = -1 if the tip is free and 1 if it is clamped; those of elongation and torsion are
(k - 1/2) pi and k pi times a velocity over L. So the relative errors of the frequencies of elements or
modes (`frequency_errors`) depend on no parameter.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import casadi as ca
import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from pydantic import Field, model_validator

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.description import Expected, Many, Name, Quantity, Text, Values
from mbdlft.base.errors import SceneError, check_known
from mbdlft.base.unit import Freedom
from mbdlft.multibody.body import beam_elements
from mbdlft.multibody.body.beam_elements import (
    LINEAR,
    ONE,
    Deformation,
    moments,
    products,
    size,
    strain,
    values_at,
)
from mbdlft.multibody.body.elastic import (
    NEGLECTED,
    Elastic,
    ElasticBody,
    Term,
    elastic_freedom,
    elastic_problem,
)
from mbdlft.multibody.body.rigid import DIAGONAL, newton_euler, unseen_name
from mbdlft.multibody.spatial import Coordinate

DEFORMATIONS = ("axial", "torsion", "bending_y", "bending_z")
SHAPES = ("cubic", "quintic")
_MOST_ELEMENTS, _MOST_MODES = 200, 40
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


class Beam(ElasticBody):
    """A uniform beam from the origin along x, in SI units.

    `deformations` names the deformations that the model has: ``axial``, ``torsion``, ``bending_y``
    (displacements along y, with the moment of area `I_z`) and ``bending_z`` (along z, with `I_y`).
    Quantities that none of them uses may be left out; but a beam that turns about its own axis has the
    inertia `density` (`I_y` + `I_z`) `length`, with and without torsion. `stations` gives names to nodes,
    1 to `elements`, which are then ports; the last node is the port ``tip`` anyway. The damping matrix is
    `mass_damping` M + `stiffness_damping` K.

    With `modes` each deformation has that many polynomials over the whole beam in place of elements, and
    `elements` only numbers the nodes of `stations`: without these, both together are an error. Modes do
    not depend on parameters. A beam with a `shear_coefficient` has rotary inertia too.
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
    elements: Annotated[int, Field(ge=1, le=_MOST_ELEMENTS, strict=True)] = 4
    modes: Annotated[int, Field(ge=1, le=_MOST_MODES, strict=True)] | None = None
    shape_functions: Text = "cubic"
    deformations: Many[Text] = DEFORMATIONS
    stations: dict[Name, Annotated[int, Field(ge=1, strict=True)]] = {}

    @model_validator(mode="after")
    def _data_are_complete(self) -> Self:
        check_known("shape_functions", [self.shape_functions], SHAPES)
        if not self.deformations or len(set(self.deformations)) < len(self.deformations):
            raise SceneError(f"deformations: expected some of {', '.join(DEFORMATIONS)}, each once.")
        for name in self.deformations:
            check_known("deformation", [name], DEFORMATIONS)
            for key in _NEEDED[name] + (("shear_modulus",) if self._has_shear(name) else ()):
                if getattr(self, key) is None:
                    raise SceneError(f"{key!r} is missing; the deformation {name!r} needs it.")
        if self.shear_coefficient is not None and self.shape_functions != "cubic":
            raise SceneError("shear_coefficient: shear is for cubic shape functions only.")
        if self.shear_coefficient is not None and self.modes is not None:
            raise SceneError(
                "modes: the modes of a beam with a shear_coefficient change with its parameters. Give "
                "`elements` in place of modes; 4 have four frequencies to 0.3 %."
            )
        if self.modes is not None and "elements" in self.model_fields_set and not self.stations:
            raise SceneError(
                f"got elements = {self.elements} and modes = {self.modes}, in the place of elements; "
                "these number the nodes of stations, and there are none. Leave one of both out; elements "
                f"are 1 to {_MOST_ELEMENTS}, and modes 1 to {_MOST_MODES}."
            )
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
        """Whether a deformation is that of a Timoshenko beam."""
        return deformation.startswith("bending") and self.shear_coefficient is not None

    @property
    def has_rotary_inertia(self) -> bool:
        """Whether the rotation of sections by bending has inertia."""
        return self.rotary_inertia or self.shear_coefficient is not None

    def own_quantities(self) -> dict[str, Expected]:
        return {
            key: Expected(source, unit)
            for key, unit in _UNITS.items()
            if (source := getattr(self, key)) is not None
        }

    def port_names(self) -> tuple[str, ...]:
        return ("origin", "tip", *self.stations)

    def elastic_ports(self) -> tuple[str, ...]:
        return ("tip", *self.stations)

    def port_position(self, port: str, values: Values) -> ca.SX:
        if port == "origin":
            return ca.SX(3, 1)
        along = self._node(port) / self.elements * values["length"]
        return ca.sparsify(ca.vertcat(ca.SX(along), ca.SX(2, 1)))

    def _node(self, port: str) -> int:
        return self.elements if port == "tip" else self.stations[port]

    def _breaks(self) -> tuple[int, ...]:
        """Nodes inside at which the shapes of modes have jumps of some derivative, ascending."""
        return tuple(sorted({node for node in self.stations.values() if node < self.elements}))

    def deformation(self, name: str) -> Deformation:
        functions = "shear" if self._has_shear(name) else self.shape_functions
        breaks = () if self.modes is None else self._breaks()
        return Deformation(name, functions, self.elements, self.modes, breaks)

    def blocks(self) -> list[tuple[str, Deformation, slice]]:
        """Deformations, and their slices of the coordinates of the body."""
        blocks, k = [], 0
        for name in (name for name in DEFORMATIONS if name in self.deformations):
            d = self.deformation(name)
            blocks.append((name, d, slice(k, k := k + size(d))))
        return blocks

    @property
    def _count(self) -> int:
        return int(self.blocks()[-1][2].stop)

    def freedoms(self) -> tuple[Freedom, ...]:
        # turns and curvatures are coordinates in meters: they are times powers of an element's length
        units = {"torsion": ("rad", "N m")}
        return tuple(
            elastic_freedom(f"{name}.{k + 1}", *units.get(name, ("m", "N")), turns=name == "torsion")
            for name, d, _ in self.blocks()
            for k in range(size(d))
        )

    def elastic(self, values: Values) -> Elastic:
        n = self._count
        mass: list[Term] = []
        stiffness: list[Term] = []
        participation: list[Term] = []
        L, rho, A = (values[key] for key in ("length", "density", "area"))
        for name, d, columns in self.blocks():
            line = self._polar(values) * rho * L if name == "torsion" else A * rho * L
            mass.append(Term(line, self._placed(columns, products(d, "displacement"))))
            stiffness += self._stiffness(name, d, columns, values)
            participation += self._participation(name, d, columns, line, L)
            if name.startswith("bending") and self.has_rotary_inertia:
                inertia = values[_AREA[name]] * rho
                mass.append(Term(inertia / L, self._placed(columns, products(d, "turn"))))
                turn = _ROW[name][1] * moments(d, "turn")
                participation.append(Term(inertia, _row(n, columns, _TURNED[name], turn)))
        return Elastic(mass, self._damping(mass, stiffness, values), stiffness, participation)

    def _damping(self, mass: list[Term], stiffness: list[Term], values: Values) -> list[Term]:
        """The terms of D of those of M and K."""
        if self.mass_damping == self.stiffness_damping == 0.0:
            return []
        terms = [Term(values["mass_damping"] * factor, matrix) for factor, matrix in mass]
        return terms + [
            Term(values["stiffness_damping"] * factor, matrix) for factor, matrix in stiffness
        ]

    @property
    def has_geometric_stiffness(self) -> bool:
        return True

    @property
    def can_spin(self) -> bool:
        thin = "torsion" not in self.deformations and not self.has_rotary_inertia
        return self.has_geometric_stiffness and thin

    def unknown_loads(self) -> tuple[int, ...]:
        if not self.has_geometric_stiffness:
            return super().unknown_loads()
        return beam_elements.unknown_loads(self.deformations)

    @property
    def _is_stiffened(self) -> bool:
        """Whether axial forces at equilibrium change the stiffness."""
        return self.has_geometric_stiffness and self.prestress != NEGLECTED

    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        wrench = super().wrench(motion, values, inboard, at)
        if self.can_spin and motion[:, 0].nnz():
            wrench += beam_elements.spinning(self.blocks(), motion, values, at)[0]
        return wrench

    def efforts(self, motion: ca.SX, values: Values, at: Coordinate) -> ca.SX:
        """Efforts as of any elastic body, written M (qddot + a qdot) + K (q + b qdot).

        With the damping D = a M + b K so written, each matrix is multiplied once only. With the loads at
        equilibrium, and what a spinning frame needs.
        """
        q = at.q + values["stiffness_damping"] * at.v
        a = at.a + values["mass_damping"] * at.v
        needed = super().efforts(motion, values, Coordinate(q, ca.SX(*at.v.shape), a))
        if self._is_stiffened:
            radius = self._radius(values)
            needed += beam_elements.stiffened_by_motion(self.blocks(), motion, values, radius, at.q)
        if self.can_spin and motion[:, 0].nnz():
            needed += beam_elements.spinning(self.blocks(), motion, values, at)[1]
        return ca.SX(needed)

    def pulled(self, port: str, values: Values, force: ca.SX, at: Coordinate) -> ca.SX:
        if not self._is_stiffened:
            return super().pulled(port, values, force, at)
        node, radius = self._node(port), self._radius(values)
        return beam_elements.pulled(self.blocks(), node, -force[0], values, radius, at.q)

    def of_second_order(self, values: Values, at: Coordinate) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Of a deformation q: by how much the first moment is less along the beam (kg m), the second
        moments (3, 3) (kg m^2) and the angular momentum (3,) that it adds to those of the straight beam.

        Second moments are those of a beam whose mass is on its axis, of others nothing.
        """
        moments, momentum = ca.SX(3, 3), ca.SX(3, 1)
        if self.can_spin:
            moments, momentum = beam_elements.second_moments(self.blocks(), values, at)
        if not self._is_stiffened:
            return ca.SX(0), moments, momentum
        stiffened = partial(
            beam_elements.stiffened_by_motion,
            self.blocks(),
            values=values,
            radius=self._radius(values),
            q=at.q,
        )
        x, still = ca.SX.eye(3)[:, :1], ca.SX(3, 2)
        if self.can_spin:
            moments[0, 0] -= ca.dot(at.q, stiffened(ca.horzcat(ca.SX.eye(3)[:, 1], still)))
        return -0.5 * ca.dot(at.q, stiffened(ca.horzcat(still, x))), moments, momentum

    def _radius(self, values: Values) -> Any:
        """Square of the polar radius of gyration of the section (m^2), if there is torsion."""
        return self._polar(values) / values["area"] if "torsion" in self.deformations else 0.0

    def _participation(
        self,
        name: str,
        d: Deformation,
        columns: slice,
        line: Any,
        length: Any,
        span: tuple[int, int | None] = (0, None),
    ) -> list[Term]:
        """Participation factors of one deformation by the mass between the nodes `span`.

        `line` is the mass of the whole beam per unit of s: kg, or kg m^2 for torsion.
        """
        n, (row, sign) = self._count, _ROW[name]
        terms = [Term(line, _row(n, columns, row, moments(d, "displacement", ONE, *span)))]
        if name.startswith("bending"):
            first = sign * moments(d, "displacement", LINEAR, *span)
            terms.append(Term(line * length, _row(n, columns, _TURNED[name], first)))
        return terms

    def _placed(self, columns: slice, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
        """A matrix (n, n) of all coordinates, zero but for `matrix` in the rows and columns `columns`."""
        whole = np.zeros((self._count, self._count))
        whole[columns, columns] = matrix
        return whole

    def _stiffness(self, name: str, d: Deformation, columns: slice, values: Values) -> list[Term]:
        """The terms of K (n, n) of one deformation."""
        L = values["length"]
        strained = self._placed(columns, products(d, strain(d)))
        if name == "axial":
            return [Term(values["area"] * values["modulus"] / L, strained)]
        if name == "torsion":
            return [Term(values["torsion_constant"] * values["shear_modulus"] / L, strained)]
        terms = [Term(values[_AREA[name]] * values["modulus"] / (L * L * L), strained)]
        if self._has_shear(name):
            rigidity = values["area"] * values["shear_coefficient"] * values["shear_modulus"]
            terms.append(Term(rigidity / L, self._placed(columns, products(d, "shear"))))
        return terms

    def _polar(self, values: Values) -> Any:
        """Polar moment of area (m^4)."""
        return values["I_y"] + values["I_z"]

    def shapes(self, port: str, values: Values) -> Sequence[Term]:
        n, node = self._count, self._node(port)
        plain, turned = np.zeros((6, n)), np.zeros((6, n))
        for name, d, columns in self.blocks():
            row, sign = _ROW[name]
            plain[row, columns] = values_at(d, "displacement", node)
            if name.startswith("bending"):
                turned[_TURNED[name], columns] = sign * values_at(d, "turn", node)
        return [Term(1.0, plain), *([Term(1.0 / values["length"], turned)] if np.any(turned) else [])]

    def total_mass(self, values: Values) -> ca.SX:
        return ca.SX(values["area"] * values["density"] * values["length"])

    def rigid_wrench(self, motion: ca.SX, values: Values) -> ca.SX:
        L, rho, A = (values[key] for key in ("length", "density", "area"))
        mass = A * rho * L
        across = mass * (L * L) / 3.0
        known = {key for key in ("I_y", "I_z") if key in values}
        # symbols stand for what is not given; it is asked for where a motion feels it
        unseen = {entry: ca.SX.sym(unseen_name(self.name, entry)) for entry in DIAGONAL}
        polar = self._polar(values) * rho * L if len(known) == 2 else unseen["xx"]
        y, z = across, across
        if self.has_rotary_inertia:
            y = y + (values["I_y"] * rho * L if "I_y" in known else unseen["yy"])
            z = z + (values["I_z"] * rho * L if "I_z" in known else unseen["zz"])
        inertia = ca.diag(ca.vertcat(ca.SX(polar), y, z))
        center = ca.vertcat(ca.SX(0.5 * L), ca.SX(2, 1))
        return newton_euler(motion, mass, ca.SX(3, 1), center, inertia)

    def unseen(self, entry: str) -> tuple[str, ...]:
        needed = {"xx": ("I_y", "I_z"), "yy": ("I_y",), "zz": ("I_z",)}[entry]
        return tuple(key for key in needed if getattr(self, key) is None)

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        for key, value in values.items():
            lowest = float(np.min(value))
            if lowest < 0.0 or (lowest == 0.0 and "damping" not in key):
                return f"{key} is not positive in the range: {lowest:g} {_UNITS[key]}."
        return elastic_problem(self, values)


_NEEDED: dict[str, tuple[str, ...]] = {
    "axial": ("modulus",),
    "torsion": ("shear_modulus", "torsion_constant", "I_y", "I_z"),
    "bending_y": ("modulus", "I_z"),
    "bending_z": ("modulus", "I_y"),
}
_AREA = {"bending_y": "I_z", "bending_z": "I_y"}  # the moment of area of each bending
# row of the displacement or rotation among the six directions, and the sign of a rotation by the slope
_ROW = {"axial": (0, 1.0), "torsion": (3, 1.0), "bending_y": (1, 1.0), "bending_z": (2, -1.0)}
_TURNED = {"bending_y": 5, "bending_z": 4}  # row of the rotation: th_z = dv/dx, th_y = -dw/dx


def _row(n: int, columns: slice, row: int, entries: NDArray[np.float64]) -> NDArray[np.float64]:
    """A matrix (6, n) of zeros with `entries` in the columns `columns` of one row."""
    whole = np.zeros((6, n))
    whole[row, columns] = entries
    return whole


SUPPORTS = ("free", "clamped")


class FrequencyErrors(NamedTuple):
    """Relative errors of the lowest frequencies of one deformation of a beam clamped at its origin.

    Attributes
    ----------
    deformation : such as ``bending_y``
    tip : ``free`` or ``clamped``, the support of the tip
    errors : (n,), positive where a frequency is too high
    """

    deformation: str
    tip: str
    errors: NDArray[np.float64]


@arguments_checked
def frequency_errors(beam: Beam, count: int = 4) -> tuple[FrequencyErrors, ...]:
    """Relative errors of the `count` lowest frequencies of each deformation, or of as many as it has.

    A beam with a `shear_coefficient` has no row for bending: its errors depend on its section. Rotary
    inertia and patches are left out.
    """
    errors = []
    for name, d, _ in beam.blocks():
        if d.functions == "shear" and name.startswith("bending"):
            continue
        mass, stiffness = products(d, "displacement"), products(d, strain(d))
        for tip in SUPPORTS:
            free = _free(d, tip)
            squares = scipy.linalg.eigvalsh(free.T @ mass @ free, free.T @ stiffness @ free)[::-1]
            frequencies = 1.0 / np.sqrt(squares[:count])
            exact = np.array([_exact(d, tip, k + 1) for k in range(len(frequencies))])
            errors.append(FrequencyErrors(name, tip, frequencies / exact - 1.0))
    return tuple(errors)


def error_sentence(beam: Beam) -> str:
    """A sentence on the errors of the first four frequencies of each kind of deformation."""
    shapes = f"{beam.elements} elements" if beam.modes is None else f"{beam.modes} modes"
    worst: dict[str, dict[str, float]] = {}
    for name, tip, errors in frequency_errors(beam):
        kind = name.partition("_")[0]
        largest = float(np.max(np.abs(errors), initial=0.0))
        worst.setdefault(kind, {})[tip] = max(largest, worst.get(kind, {}).get(tip, 0.0))
    listed = "; ".join(
        f"{kind} {largest_by_tip['free']:.1e} (tip free), {largest_by_tip['clamped']:.1e} (tip clamped)"
        for kind, largest_by_tip in worst.items()
    )
    return (
        f"beam {beam.name!r}, {shapes}: errors of the first four frequencies by the shape functions: "
        f"{listed or 'not known with shear'}"
    )


def _free(d: Deformation, tip: str) -> NDArray[np.float64]:
    """A basis (n, m) of the deformations that the support of the tip allows."""
    held = [values_at(d, "displacement", d.elements)]
    if d.name.startswith("bending"):
        held.append(values_at(d, "turn", d.elements))
    n = len(held[0])
    return np.asarray(np.eye(n) if tip == "free" else scipy.linalg.null_space(np.array(held)))


def _exact(d: Deformation, tip: str, number: int) -> float:
    """The exact frequency, over what it is proportional to, of one mode, counted from 1."""
    from scipy.optimize import brentq  # here because it is slow to import

    free = tip == "free"
    if not d.name.startswith("bending"):
        return float((number - 0.5 if free else number) * np.pi)
    first = number - 1 if free else number
    sign = 1.0 if free else -1.0
    root = brentq(
        lambda z: np.cos(z) + sign / np.cosh(z), first * np.pi + 1e-9, (first + 1) * np.pi, xtol=1e-14
    )
    return float(root) ** 2
