"""A flexible body that its modes describe: frequencies, damping, participation factors, shapes at ports.

    M = 1,  D = diag(2 xi_k w_k),  K = diag(w_k^2),  P = [participation_k],  Phi = [shape_k]

The modes are those of the body clamped at its origin, and have unit mass.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Self, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import InstanceOf, model_validator

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
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Freedom
from mbdlft.multibody.body.elastic import (
    Elastic,
    ElasticBody,
    Term,
    elastic_freedom,
    elastic_problem,
)
from mbdlft.multibody.body.rigid import Inertia, RigidBody
from mbdlft.multibody.spatial import Coordinate

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
    inertia: InstanceOf[Inertia]
    modes: Many[InstanceOf[Mode]]

    @model_validator(mode="after")
    def _data_are_complete(self) -> Self:
        if not self.modes:
            raise SceneError("modes: at least one is needed; a body without modes is 'rigid'.")
        if self.inertia.about not in ("center_of_mass", *self.port_names()):
            raise SceneError(
                f"inertia.about: expected 'center_of_mass', 'origin' or a port, got "
                f"{self.inertia.about!r}."
            )
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
        return Elastic(
            mass=[Term(1.0, np.eye(n))],
            damping=damping,
            stiffness=stiffness,
            participation=self._columns("participation", values),
        )

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
        return RigidBody(
            name=self.name,
            mass=self.mass,
            center_of_mass=self.center_of_mass,
            inertia=self.inertia,
            ports=self.ports,
        )

    def rigid_wrench(self, motion: ca.SX, values: Values) -> ca.SX:
        none = ca.SX(0, 1)
        return self._undeformed().wrench(motion, values, ca.SX(3, 1), Coordinate(none, none, none))

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        problem = self._undeformed().physical_problem(values) or self._frequency_problem(values)
        return problem or elastic_problem(self, values)

    def _frequency_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        """A sentence if the frequency of a mode is not positive at one of the samples (samples,)."""
        for k in range(1, len(self.modes) + 1):
            lowest = float(np.min(values[f"mode{k}.frequency"]))
            if not lowest > 0.0:
                return (
                    f"mode {k}: the frequency is not positive in the range: {lowest:g} rad/s, so the "
                    "stiffness is not positive definite."
                )
        return None
