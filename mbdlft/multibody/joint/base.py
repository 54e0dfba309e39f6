"""The base classes of all kinds of joints: two ports, an orientation, coordinates, and moves.

A joint leads from the frame p of its parent's port to the frame c of its child's port, by R_pc and r_pc
(see `mbdlft.multibody.spatial`). At zero position, and without an `orientation`, R_pc = 1 and r_pc = 0.
The coordinates of a joint are displacements from the equilibrium.
"""

import abc
from collections.abc import Mapping
from functools import lru_cache
from typing import ClassVar, Literal, Self, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import InstanceOf, model_validator

from mbdlft.base.description import (
    Axis,
    Description,
    Direction,
    Expected,
    Many,
    Name,
    Quantity,
    Text,
    Values,
)
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Freedom, Signal
from mbdlft.multibody.joint.move import Move, turned
from mbdlft.multibody.spatial import Coordinate
from mbdlft.problem.sx import constants


def turning(label: str = "", suffix: str = "", *, of: str = "angle") -> Freedom:
    """A coordinate that is an angle (rad), or a component of a small rotation vector."""
    second = "acceleration" if not label else "angular_acceleration"
    return Freedom(
        label,
        Signal(f"torque{suffix}", "N m"),
        (
            Signal(f"{of}{suffix}", "rad"),
            Signal(f"rate{suffix}", "rad/s"),
            Signal(f"{second}{suffix}", "rad/s^2"),
        ),
        turns=True,
    )


def sliding(label: str = "", suffix: str = "") -> Freedom:
    """A coordinate that is a displacement (m)."""
    return Freedom(
        label,
        Signal(f"force{suffix}", "N"),
        (
            Signal(f"position{suffix}", "m"),
            Signal(f"velocity{suffix}", "m/s"),
            Signal(f"acceleration{suffix}", "m/s^2"),
        ),
        turns=False,
    )


@final
class Rotation(Description):
    """A rotation by `angle` (rad) about `axis`, whose components are in the axes before this rotation."""

    noun: ClassVar[str] = "orientation"

    axis: Axis
    angle: Quantity


class Joint(Description, abc.ABC):
    """A joint; every concrete kind is final. `parent` and `child` are ``body`` or ``body.port``.

    `orientation` is a sequence of rotations from the axes of the parent's port to those of the joint.
    """

    noun: ClassVar[str] = "joint"

    kind: ClassVar[str]
    freedoms: ClassVar[tuple[Freedom, ...]]

    name: Name
    parent: Text
    child: Text
    orientation: Many[InstanceOf[Rotation]] = ()

    def own_quantities(self) -> dict[str, Expected]:
        """The quantities of this kind by label, without those of the orientation."""
        return {}

    def quantities(self) -> dict[str, Expected]:
        """All quantities by label, each as it was given and with the unit that its value must have."""
        angles = {
            f"orientation.{k}": Expected(r.angle, "rad") for k, r in enumerate(self.orientation)
        }
        return angles | self.own_quantities()

    def moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        """The moves that make the joint, in their order from the parent's port to the child's.

        `values` has one SX or float per label, `at` the coordinates of the joint.
        """
        placed: tuple[Move, ...] = ()
        for k, rotation in enumerate(self.orientation):
            placed += turned(unit_vector(rotation.axis), values[f"orientation.{k}"])
        return placed + self.own_moves(values, at)

    @abc.abstractmethod
    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        """The moves of the joint that follow its orientation."""

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        """The condition of physics that fails at one of the sampled values (samples,), or None."""
        for label, value in values.items():
            if label.startswith(("actuator_inertia", "reflected_inertia")) and np.min(value) < 0:
                return f"the {label} is negative in the range: {float(np.min(value)):g}."
        return None


class MovingJoint(Joint, abc.ABC):
    """A joint with coordinates.

    A kind declares `position`, `stiffness`, `damping`, `actuator_inertia` and `preload`: each is a
    quantity if the kind has one coordinate, and a tuple of quantities, one for each coordinate, if it
    has several. `preload` is the effort at equilibrium; where it is left out, the trim solves for it.
    The model has the effort of a joint as input; for an `imposed` joint, its acceleration, and the motion
    has states. With `imposed` = ``motion``, position, rate and acceleration are three inputs, and the
    motion has no state.
    """

    imposed: bool | Literal["motion"] = False

    @model_validator(mode="after")
    def _imposed_has_no_preload(self) -> Self:
        given = getattr(self, "preload", None)
        if self.imposed and given is not None and any(entry != 0 for entry in _entries(given)):
            raise SceneError(
                f"an imposed joint takes the effort that its acceleration needs, so it has no preload, "
                f"got {given!r}. Leave out preload or imposed."
            )
        return self

    def own_quantities(self) -> dict[str, Expected]:
        quantities: dict[str, Expected] = {}
        for key, (turn, slide) in _UNITS.items():
            given = getattr(self, key, None)
            if given is None or (key == "preload" and self.imposed):
                continue
            for freedom, value in zip(self.freedoms, _entries(given), strict=False):
                unit = turn if freedom.turns else slide
                quantities[coordinate_label(key, freedom)] = Expected(value, unit)
        return quantities


_UNITS = {
    "position": ("rad", "m"),
    "stiffness": ("N m/rad", "N/m"),
    "damping": ("N m s/rad", "N s/m"),
    "actuator_inertia": ("kg m^2", "kg"),
    "preload": ("N m", "N"),
}


def _entries(given: Quantity | tuple[Quantity, ...]) -> tuple[Quantity, ...]:
    """The quantities of each coordinate."""
    return given if isinstance(given, tuple) else (given,)


def coordinate_label(key: str, freedom: Freedom) -> str:
    """Label of a quantity of one coordinate: ``stiffness``, or ``stiffness.x``."""
    return f"{key}.{freedom.label}" if freedom.label else key


@lru_cache(maxsize=256)  # a scene has few directions, and each is used many times
def unit_vector(direction: Direction) -> ca.SX:
    """The direction with unit length (3,); a zero component is a structural zero of the SX."""
    return constants.unit_vector(direction)
