"""Elastic bodies: small deformations about a floating frame at the origin; bodies given by modes.

    [force ; torque] = rigid part + P qddot + [0 ; (P_u q) x a]
    efforts          = M qddot + D qdot + K q + P' [a ; alpha]
    [u ; phi] of a port = Phi q

The n coordinates q describe the deformation of the body clamped at its origin, where the joint that
leads to it ends. P (6, n) are the participation factors, P_u (3, n) those of the translations; M, D, K
(n, n) the matrices of the clamped body; Phi (6, n) the shapes at a port. (P_u q) x a is the torque of
the displaced mass in the acceleration a of the frame, which includes gravity. Terms of second order in
q are left out, and so are a spinning frame and what loads at equilibrium do to K, but for beams.

Source: equations (5.6), (5.11) to (5.15) of the two-port models in `tests/reference/flexible.py`; here
the motion of the frame need not be small.

A flexible body is described by modes of unit mass of the body clamped at its origin:

    M = 1,  D = diag(2 xi_k w_k),  K = diag(w_k^2),  P = [participation_k],  Phi = [shape_k]
"""

import abc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from mbdlft.base.description import (
    ANY_UNIT,
    AXES,
    Description,
    Expected,
    Many,
    Quantity,
    Text,
    Values,
    Vector,
)
from mbdlft.base.errors import SceneError, check_known
from mbdlft.base.unit import Freedom, Signal
from mbdlft.multibody.body.rigid import Body, Inertia, RigidBody
from mbdlft.multibody.spatial import Coordinate

NEGLECTED, AXIAL = "neglected", "axial"
_LARGEST = 1e100  # products of such numbers are still numbers
_ROUNDING = 1e-12  # a negative eigenvalue below this part of the largest entry is rounding
_RESIDUAL = 1e-6  # the same for the residual mass: data are often given with few digits


class Term(NamedTuple):
    """A scalar `factor` times a `matrix` of numbers; a matrix with parameters is a sum of such terms."""

    factor: ca.SX | float
    matrix: NDArray[np.float64]


class Elastic(NamedTuple):
    """M, D, K (n, n) and P (6, n) as sums of terms."""

    mass: Sequence[Term]
    damping: Sequence[Term]
    stiffness: Sequence[Term]
    participation: Sequence[Term]


class ElasticBody(Body, abc.ABC):
    """An elastic body; every concrete kind is final.

    The loads that a body carries at equilibrium change its stiffness. What they change is known for axial
    forces in beams only; a body that carries others must say `prestress` = ``neglected``, which leaves
    the change out, or ``axial``, which leaves out that of the others.
    """

    prestress: Text | None = None

    @model_validator(mode="after")
    def _prestress_is_known(self) -> Self:
        words = (NEGLECTED, AXIAL) if self.has_geometric_stiffness else (NEGLECTED,)
        if self.prestress is not None and self.prestress not in words:
            listed = ", ".join(map(repr, words))
            raise SceneError(f"prestress: expected {listed} or nothing, got {self.prestress!r}.")
        return self

    @property
    def has_geometric_stiffness(self) -> bool:
        """Whether the stiffness by axial forces at equilibrium is known."""
        return False

    @property
    def can_spin(self) -> bool:
        """Whether the equations hold in a frame that spins."""
        return False

    def unknown_loads(self) -> tuple[int, ...]:
        """Forces and torques, 0 to 5, whose effect on the stiffness these equations do not have."""
        return tuple(range(6))

    def elastic_ports(self) -> tuple[str, ...]:
        """Ports that move with the deformation."""
        return tuple(self.ports)

    @abc.abstractmethod
    def elastic(self, values: Values) -> Elastic:
        """M, D, K and P of the body clamped at its origin."""

    @abc.abstractmethod
    def shapes(self, port: str, values: Values) -> Sequence[Term]:
        """The terms of Phi (6, n) of a port."""

    @abc.abstractmethod
    def rigid_wrench(self, motion: ca.SX, values: Values) -> ca.SX:
        """Wrench (3, 2) about the origin that a motion (3, 3) of the undeformed body needs."""

    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        """Wrench (3, 2) about the origin: rigid part + P qddot + [0 ; (P_u q) x a]."""
        participation = self.elastic(values).participation
        needed = times(participation, at.a)
        displaced = ca.cross(times(participation, at.q)[:3], motion[:, 2])
        elastic = ca.horzcat(needed[:3], needed[3:] + displaced)
        return ca.SX(self.rigid_wrench(motion, values) + elastic)

    def efforts(self, motion: ca.SX, values: Values, at: Coordinate) -> ca.SX:
        """Generalized forces (n,): M qddot + D qdot + K q + P' [a ; alpha]."""
        e = self.elastic(values)
        inertial = times_transposed(e.participation, ca.vertcat(motion[:, 2], motion[:, 1]))
        deforming = times(e.mass, at.a) + times(e.damping, at.v) + times(e.stiffness, at.q)
        return ca.SX(deforming + inertial)

    def restoring(self, values: Values, q: ca.SX) -> ca.SX:
        """Generalized forces K q (n,) that hold a static deflection q (n,)."""
        return times(self.elastic(values).stiffness, q)

    def pulled(self, port: str, values: Values, force: ca.SX, at: Coordinate) -> ca.SX:
        """Generalized forces (n,) by which a force along the body at a port stiffens it.

        `force` (3,) is what the body exerts on what is outside, in the axes of the body (N).
        """
        return ca.SX(len(self.freedoms()), 1)


def elastic_freedom(label: str, unit: str, effort: str, *, turns: bool = False) -> Freedom:
    """A coordinate of a deformation in the unit `unit`, with its generalized force in `effort`."""
    measures = (
        Signal(f"{label}.displacement", unit),
        Signal(f"{label}.velocity", f"{unit}/s"),
        Signal(f"{label}.acceleration", f"{unit}/s^2"),
    )
    return Freedom(label, Signal(f"{label}.force", effort), measures, turns=turns)


def times(terms: Sequence[Term], vector: ca.SX) -> ca.SX:
    """A sum of terms (m, n) times a vector (n,).

    Each matrix is multiplied with the vector first, so a factor is multiplied m times only.
    """
    total = ca.SX(terms[0].matrix.shape[0], 1) if terms else ca.SX(vector.numel(), 1)
    for factor, matrix in terms:
        total = total + factor * ca.mtimes(ca.sparsify(ca.SX(matrix)), vector)
    return total


def times_transposed(terms: Sequence[Term], vector: ca.SX) -> ca.SX:
    """The transpose of a sum of terms (m, n) times a vector (m,); factors meet the vector first."""
    total = ca.SX(terms[0].matrix.shape[1], 1)
    for factor, matrix in terms:
        total = total + ca.mtimes(ca.sparsify(ca.SX(matrix.T)), factor * vector)
    return total


def dense(terms: Sequence[Term], samples: int) -> NDArray[np.float64]:
    """A sum of terms whose factors are numbers or arrays (samples,), as matrices (samples, ., .)."""
    total: Any = 0.0
    for factor, matrix in terms:
        total = total + np.broadcast_to(factor, (samples,))[:, None, None] * matrix
    return np.asarray(total, dtype=float)


@np.errstate(all="ignore")
def elastic_problem(body: ElasticBody, values: Mapping[str, NDArray[np.float64]]) -> str | None:
    """The condition of physics that fails at one of the samples, or None.

    M and K must be positive definite, D and the residual mass matrix, rigid minus P M^-1 P', positive
    semidefinite.
    """
    e, rigid = body.elastic(values), _rigid_mass(body, values)
    mass, stiffness, coupling, damping = (
        dense(terms, len(rigid)) for terms in (e.mass, e.stiffness, e.participation, e.damping)
    )
    for matrix in (mass, stiffness, coupling, damping, rigid):
        largest = float(np.max(np.abs(matrix), initial=0.0))
        if not largest < _LARGEST:
            return f"an entry of its matrices is {largest:.3g} in the range; no body has such numbers."
    for name, matrix in (("mass", mass), ("stiffness", stiffness)):
        if not (smallest := _smallest_eigenvalue(matrix)) > 0.0:
            return (
                f"the {name} matrix of its deformations is not positive definite in the range: smallest "
                f"eigenvalue {smallest:.3g}. Frequencies must be positive."
            )
    if e.damping and (smallest := _smallest_eigenvalue(damping)) < -_ROUNDING * np.max(np.abs(damping)):
        return f"the damping is negative in the range: smallest eigenvalue {smallest:.3g}."
    carried = coupling @ np.linalg.solve(mass, np.swapaxes(coupling, 1, 2))
    residual = rigid - carried
    if (smallest := _smallest_eigenvalue(residual)) < -_RESIDUAL * np.max(np.abs(rigid)):
        return (
            "the participation factors exceed the rigid mass: the residual mass matrix (rigid minus "
            f"effective mass) has the eigenvalue {smallest:.3g} in the range. Check their scaling (modes "
            "of unit mass), their point (the origin of the body), and the mass, center and inertia."
        )
    return None


def _smallest_eigenvalue(matrices: NDArray[np.float64]) -> float:
    """Of the symmetric parts of matrices (samples, n, n)."""
    return float(np.min(np.linalg.eigvalsh(0.5 * (matrices + np.swapaxes(matrices, 1, 2)))))


def _rigid_mass(body: ElasticBody, values: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Mass matrices (samples, 6, 6) of the undeformed body about its origin.

    Their columns are the wrenches that unit accelerations of the body need.
    """
    symbols = {name: ca.SX.sym(name) for name in values}
    alpha, acceleration = ca.SX.sym("alpha", 3), ca.SX.sym("acceleration", 3)
    motion = ca.horzcat(ca.SX(3, 1), alpha, acceleration)
    wrench = ca.vec(body.rigid_wrench(motion, symbols))
    mass = ca.jacobian(wrench, ca.vertcat(acceleration, alpha))
    unseen = [s for s in ca.symvar(mass) if s.name() not in symbols]
    mass = ca.substitute(mass, ca.vertcat(ca.SX(0, 1), *unseen), ca.SX.zeros(len(unseen)))
    function = ca.Function("mass", [ca.vertcat(*symbols.values())], [ca.densify(mass)])
    samples = max(np.size(value) for value in values.values())
    table = np.stack([np.broadcast_to(values[name], (samples,)) for name in symbols])
    masses: NDArray[np.float64] = function(table).full().reshape(6, samples, 6).transpose(1, 0, 2)
    return masses


Six = tuple[Quantity, Quantity, Quantity, Quantity, Quantity, Quantity]
_DIRECTIONS = (*AXES, *(f"r{axis}" for axis in AXES))


@final
class Mode(Description):
    """One mode of unit mass: `frequency` (rad/s), `damping` ratio, `participation`, shapes at ports.

    `participation` has three factors for translations (kg^1/2) and three for rotations about the origin
    (kg^1/2 m), in the axes of the body. Each factor is minus the modal force that a unit acceleration of
    the body causes. A shape has three displacements (kg^-1/2) and three rotations (kg^-1/2 m^-1).
    """

    noun: ClassVar[str] = "modes"

    frequency: Quantity
    damping: Quantity = 0.0
    participation: Six
    shapes: dict[Text, Six] = {}


@final
class FlexibleBody(ElasticBody):
    """A body with the rigid properties of a `RigidBody`, and with `modes`.

    The modes are those of the body held at its origin.
    """

    kind: ClassVar[str] = "flexible"

    mass: Quantity
    center_of_mass: Vector = (0.0, 0.0, 0.0)
    inertia: Inertia
    modes: Many[Mode]

    @model_validator(mode="after")
    def _data_are_complete(self) -> Self:
        if not self.modes:
            raise SceneError("modes: at least one is needed; a body without modes is 'rigid'.")
        points = ("center_of_mass", *self.port_names())
        check_known("port", [self.inertia.about], points, "inertia.about")
        for k, mode in enumerate(self.modes, start=1):
            for port in self.ports:
                if port not in mode.shapes:
                    raise SceneError(
                        f"mode {k} has no shape at the port {port!r}. Give shapes.{port} = three "
                        "displacements and three rotations."
                    )
            for port in mode.shapes:
                if port not in self.ports:
                    raise SceneError(f"mode {k} has a shape at {port!r}, which is not a port.")
        return self

    def own_quantities(self) -> dict[str, Expected]:
        quantities = self._undeformed().own_quantities()
        for k, mode in enumerate(self.modes, start=1):
            quantities[f"mode{k}.frequency"] = Expected(mode.frequency, "rad/s")
            quantities[f"mode{k}.damping"] = Expected(mode.damping, "1")
            for place, entries in (("participation", mode.participation), *mode.shapes.items()):
                for direction, entry in zip(_DIRECTIONS, entries, strict=True):
                    # their units have the square root of kg, which the check of units cannot express
                    quantities[f"mode{k}.{place}.{direction}"] = Expected(entry, ANY_UNIT)
        return quantities

    def freedoms(self) -> tuple[Freedom, ...]:
        return tuple(
            elastic_freedom(f"mode{k}", "kg^1/2 m", "kg^1/2 m/s^2")  # of unit mass
            for k in range(1, len(self.modes) + 1)
        )

    def elastic(self, values: Values) -> Elastic:
        n = len(self.modes)
        stiffness, damping = [], []
        for k in range(n):
            only = np.zeros((n, n))
            only[k, k] = 1.0
            frequency, ratio = values[f"mode{k + 1}.frequency"], values[f"mode{k + 1}.damping"]
            stiffness.append(Term(frequency * frequency, only))
            damping.append(Term(2.0 * ratio * frequency, only))
        mass = [Term(1.0, np.eye(n))]
        return Elastic(mass, damping, stiffness, self._columns("participation", values))

    def shapes(self, port: str, values: Values) -> Sequence[Term]:
        return self._columns(port, values)

    def _columns(self, place: str, values: Values) -> list[Term]:
        """A matrix (6, n) with one column for each mode, as terms.

        The first term has all entries that are numbers, each other term has one entry with parameters.
        """
        n = len(self.modes)
        numbers = np.zeros((6, n))
        terms: list[Term] = []
        for k in range(n):
            for row, direction in enumerate(_DIRECTIONS):
                entry = values[f"mode{k + 1}.{place}.{direction}"]
                if isinstance(entry, float):
                    numbers[row, k] = entry
                    continue
                only = np.zeros((6, n))
                only[row, k] = 1.0
                terms.append(Term(entry, only))
        return [Term(1.0, numbers), *terms]

    def _undeformed(self) -> RigidBody:
        """The body without its modes."""
        return RigidBody(**{key: getattr(self, key) for key in RigidBody.model_fields})

    def rigid_wrench(self, motion: ca.SX, values: Values) -> ca.SX:
        none = ca.SX(0, 1)
        return self._undeformed().wrench(motion, values, ca.SX(3, 1), Coordinate(none, none, none))

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        for k in range(1, len(self.modes) + 1):
            lowest = float(np.min(values[f"mode{k}.frequency"]))
            if not lowest > 0.0:
                return (
                    f"mode {k}: the frequency is not positive in the range: {lowest:g} rad/s, so the "
                    "stiffness is not positive definite."
                )
        return elastic_problem(self, values)
