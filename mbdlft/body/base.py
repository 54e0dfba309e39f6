"""What every kind of body has: a name, ports, quantities, and a wrench for a motion."""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from mbdlft.description import Description, Expected, Text, Values, Vector, vector_quantities
from mbdlft.errors import SceneError

GROUND = "ground"


class Body(Description, abc.ABC):
    """A body; every concrete kind is final. Positions are in the body frame, from its origin (m)."""

    kind: ClassVar[str]
    name: Text
    ports: dict[Text, Vector] = {}

    @classmethod
    def where(cls, fields: Mapping[str, Any]) -> str:
        return f"body {fields.get('name', '')!r}"

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
        """The quantities of this kind by label, apart from the ports."""
        return {}

    def quantities(self) -> dict[str, Expected]:
        """All quantities by label, each as given and with the unit it must fit."""
        found = self.own_quantities()
        for port, position in self.ports.items():
            found |= vector_quantities(f"ports.{port}", position, "m")
        return found

    def port_names(self) -> tuple[str, ...]:
        """Ports a joint can name: the origin and the declared ones."""
        return ("origin", *self.ports)

    def port_label(self, port: str) -> str | None:
        """Label of the position of a port among the quantities; None for the origin."""
        return None if port == "origin" else f"ports.{port}"

    @abc.abstractmethod
    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX) -> ca.SX:
        """Wrench (3, 2) that the motion (3, 3) of the inboard port needs, about that port.

        `values` has one SX or float per label; `inboard` (3,) is the position of the port (m).
        """

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        """Which condition of physics fails at one of the sampled values, or None."""
        return None
