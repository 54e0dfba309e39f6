"""The base class of all kinds of bodies: name, ports, quantities, and the wrench that a motion needs."""

import abc
from collections.abc import Mapping
from typing import ClassVar, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from mbdlft.base.description import (
    AXES,
    Description,
    Expected,
    Name,
    Values,
    Vector,
    vector_quantities,
)
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Freedom, Signal
from mbdlft.multibody.spatial import Coordinate, column

GROUND = "ground"


class Body(Description, abc.ABC):
    """A body; every concrete kind is final.

    `ports` are the positions of named points from the origin of the body, in its axes (m). The equations
    of a body are about one of its ports, the inboard port, where the joint that leads to the body ends.
    """

    noun: ClassVar[str] = "body"

    kind: ClassVar[str]
    name: Name
    ports: dict[Name, Vector] = {}

    @model_validator(mode="after")
    def _names_are_free(self) -> Self:
        built_in = set(self.port_names()) - set(self.ports)
        for port in self.ports:
            if port in built_in or self.port_names().count(port) > 1:
                raise SceneError(f"every body has the port {port!r} already; use another name.")
            if "." in port:
                raise SceneError(f"the name of the port {port!r} has a dot.")
        if (self.name == GROUND) != (self.kind == GROUND):
            raise SceneError(
                f"{GROUND!r} is the name of the ground and of nothing else; got the name {self.name!r} "
                f"with the kind {self.kind!r}."
            )
        return self

    def own_quantities(self) -> dict[str, Expected]:
        """The quantities of this kind by label, without the positions of the ports."""
        return {}

    def quantities(self) -> dict[str, Expected]:
        """All quantities by label, each as it was given and with the unit that its value must have."""
        quantities = self.own_quantities()
        for port, position in self.ports.items():
            quantities |= vector_quantities(f"ports.{port}", position, "m")
        return quantities

    def port_names(self) -> tuple[str, ...]:
        """Ports that a joint can name: the origin and the declared ones."""
        return ("origin", *self.ports)

    def port_label(self, port: str) -> str | None:
        """Label of the position of a port among the quantities; None for the origin."""
        return None if port == "origin" else f"ports.{port}"

    def port_position(self, port: str, values: Values) -> ca.SX:
        """Position (3,) of a port from the origin, in the axes of the undeformed body (m)."""
        label = self.port_label(port)
        if label is None:
            return ca.SX(3, 1)
        return column(values[f"{label}.{axis}"] for axis in AXES)

    def freedoms(self) -> tuple[Freedom, ...]:
        """Names of the coordinates of an elastic body; a rigid body has no coordinates."""
        return ()

    @abc.abstractmethod
    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        """Wrench (3, 2) about the inboard port that the motion (3, 3) of this port needs.

        `values` has one SX or float per label; `inboard` (3,) is the position of the inboard port from
        the origin (m); `at` has the coordinates of an elastic body. All vectors are in the axes of the
        body.
        """

    def efforts(self, motion: ca.SX, values: Values, at: Coordinate) -> ca.SX:
        """Generalized forces (n,) that a motion (3, 3) needs on the coordinates of an elastic body."""
        return ca.SX(0, 1)

    def inputs(self) -> tuple[Signal, ...]:
        """Inputs of the body itself, such as a voltage; zero at equilibrium."""
        return ()

    def outputs(self) -> tuple[Signal, ...]:
        """Outputs of the body itself, such as a charge."""
        return ()

    def driven(self, values: Values, inputs: ca.SX) -> ca.SX:
        """Generalized forces (n,) on the coordinates of an elastic body by its inputs."""
        return ca.SX(len(self.freedoms()), 1)

    def measure(self, values: Values, inputs: ca.SX, at: Coordinate) -> ca.SX:
        """Outputs (m,) for the inputs and coordinates of the body."""
        return ca.SX(0, 1)

    def total_mass(self, values: Values) -> ca.SX:
        """Mass of the body (kg)."""
        return ca.SX(values.get("mass", 0.0))

    def first_moment(self, values: Values, inboard: ca.SX) -> ca.SX:
        """First moment of mass (3,) of the undeformed body about the inboard port (kg m).

        The first moment m c appears in the torque m c x a that an acceleration a needs; accelerations
        along x and y give all three components.
        """
        zero = ca.SX(len(self.freedoms()), 1)
        x, y = (
            self.wrench(
                ca.horzcat(ca.SX(3, 2), ca.SX.eye(3)[:, k]),
                values,
                inboard,
                Coordinate(zero, zero, zero),
            )
            for k in range(2)
        )
        return ca.vertcat(y[2, 1], -x[2, 1], x[1, 1])

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        """The condition of physics that fails at one of the sampled values (samples,), or None."""
        return None
