"""Couplings between coordinates of joints: gears, belts, racks, screws, cables. All are one relation,

    0 = c1 q1 + c2 q2 + ... ,        effort_i = c_i f

of displacements q from the equilibrium, with coefficients that are rational in the parameters, and a
force f (N, or N m where the relation is one of angles) that does no work on motions that fit. In a rigid
one f is a multiplier; with a `stiffness` k and a `damping` c, e = c1 q1 + c2 q2 + ... gives way:

    f = f0 - k e - c e_dot

Of a planetary gear (Willis 1841): (w_sun - w_carrier) = -ratio (w_ring - w_carrier).
"""

import abc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from mbdlft.base.description import Description, Expected, Name, Quantity, Text, Values
from mbdlft.base.errors import SceneError, check_known
from mbdlft.base.unit import Freedom, Signal
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.joint.kinds import Pair

Two = tuple[Text, Text]
_UNITS = {("rad", True): "1", ("rad", False): "1/m", ("m", True): "m", ("m", False): "1"}
_LAWS = {"rad": ("torque", "N m", "N m/rad", "N m s/rad"), "m": ("force", "N", "N/m", "N s/m")}


class Term(NamedTuple):
    """One term of a relation: sign * quantity * coordinate."""

    coordinate: str  # NAME of a joint with one coordinate, or NAME.angle, NAME.position, NAME.x, ...
    sign: float = 1.0
    label: str = ""  # of the quantity; none: it is 1
    source: Quantity = 1.0
    turns: bool | None = None  # whether the coordinate must be an angle; None: either


class Coupling(Description, abc.ABC):
    """A linear relation between coordinates of joints; every concrete kind is final.

    A coordinate is the name of a joint that has one, or such as ``slider.position``, ``base.position.x``.
    The relation holds for motions from the equilibrium. With an `offset` (rad or m), the sum of the
    positions with the coefficients, a position that is not declared follows from the others, and
    positions that are all declared are checked. Without `stiffness` the coupling is rigid. With one (N
    m/rad or N/m, and `damping`) it gives way, and `preload` (N m or N) is its force at equilibrium; where
    that is left out, the trim solves for it.
    """

    noun: ClassVar[str] = "coupling"

    kind: ClassVar[str]
    unit: ClassVar[str] = ""  # of the relation, "rad" or "m"; "": that of its first coordinate

    name: Name
    offset: Quantity | None = None
    stiffness: Quantity | None = None
    damping: Quantity = 0.0
    preload: Quantity | None = None

    @abc.abstractmethod
    def terms(self) -> tuple[Term, ...]:
        """The terms of the relation."""

    @model_validator(mode="before")
    @classmethod
    def _without_backlash(cls, fields: Any) -> Any:
        if isinstance(fields, Mapping) and "backlash" in fields:
            raise SceneError(
                f"backlash: got {fields['backlash']!r}. A coupling with play has no linear model. Leave "
                "it out for teeth that touch; a stiffness of 0 is one whose teeth do not."
            )
        return fields

    @model_validator(mode="after")
    def _is_a_law(self) -> Self:
        laws_given = {"damping": self.damping != 0.0, "preload": self.preload is not None}
        for key in (key for key, is_given in laws_given.items() if is_given and self.stiffness is None):
            raise SceneError(
                f"{key}: a rigid coupling has none, got {getattr(self, key)!r}: its force follows. Give "
                f"a stiffness, or leave out {key}."
            )
        names = [term.coordinate for term in self.terms()]
        if len(names) < 2 or len(set(names)) < len(names):
            listed = ", ".join(names) or "none"
            raise SceneError(f"expected two or more different coordinates, got {listed}.")
        return self

    def freedoms(self, joints: Sequence[Joint]) -> list[tuple[Joint, Freedom]]:
        """The coordinate of each term; a SceneError if there is no such one."""
        by_name, freedoms = {joint.name: joint for joint in joints}, list[tuple[Joint, Freedom]]()
        for term in self.terms():
            name, _, measure = term.coordinate.partition(".")
            check_known("joint", [name], by_name, f"coupling {self.name!r}")
            joint = by_name[name]
            choices = {freedom.measures[0].name: freedom for freedom in joint.freedoms}
            if not measure and len(choices) == 1:
                (measure,) = choices
            if measure not in choices:
                listed = ", ".join(f"{name}.{choice}" for choice in choices) or "none"
                raise SceneError(
                    f"coupling {self.name!r}: {term.coordinate!r} is no coordinate of joint {name!r}, "
                    f"which is {joint.kind}. Its coordinates: {listed}."
                )
            freedom = choices[measure]
            if freedom.turns and joint.kind in ("spherical", "free"):
                raise SceneError(
                    f"coupling {self.name!r}: {term.coordinate!r} is a component of a small rotation "
                    "about all axes, which no gear follows. Use revolute or universal joints."
                )
            if term.turns not in (None, freedom.turns):
                is_turn, wanted = ("an angle", "a distance")[:: 1 if freedom.turns else -1]
                raise SceneError(
                    f"coupling {self.name!r}: {term.coordinate!r} is {is_turn} (joint {name!r} is "
                    f"{joint.kind}), and a {self.kind} has {wanted} there. Between an angle and a "
                    "distance stand rack (radius) and screw (pitch)."
                )
            if (same := (joint, freedom)) in freedoms:
                first = self.terms()[freedoms.index(same)].coordinate
                raise SceneError(
                    f"coupling {self.name!r}: {first!r} and {term.coordinate!r} are the same coordinate, "
                    "which cannot be coupled to itself."
                )
            freedoms.append((joint, freedom))
        return freedoms

    def measured_in(self, joints: Sequence[Joint]) -> str:
        """The unit of the relation, ``rad`` or ``m``."""
        return self.unit or ("rad" if self.freedoms(joints)[0][1].turns else "m")

    def signal(self, joints: Sequence[Joint]) -> Signal:
        """The force in the coupling."""
        name, unit, _, _ = _LAWS[self.measured_in(joints)]
        return Signal(f"{self.name}.{name}", unit)

    def quantities(self, joints: Sequence[Joint]) -> dict[str, Expected]:
        """All quantities by label, each as it was given and with the unit that its value must have."""
        unit = self.measured_in(joints)
        _, force, stiffness, damping = _LAWS[unit]
        quantities = {
            term.label: Expected(term.source, _UNITS[unit, freedom.turns])
            for term, (_, freedom) in zip(self.terms(), self.freedoms(joints), strict=True)
            if term.label
        }
        laws = {"offset": unit, "stiffness": stiffness, "damping": damping, "preload": force}
        laws_given = {key: getattr(self, key) for key in laws}
        return quantities | {k: Expected(x, laws[k]) for k, x in laws_given.items() if x is not None}

    def coefficients(self, values: Values) -> list[Any]:
        """The coefficients of the terms, from values by label."""
        return [term.sign * values[term.label] if term.label else term.sign for term in self.terms()]

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        """The coefficient that vanishes at sampled values (samples,), in words, or None."""
        for term in self.terms():
            low, high = (end(values.get(term.label, np.ones(1))) for end in (np.min, np.max))
            if low <= 0.0 <= high:
                source = f" = {term.source!r}"
                where = "is 0" if low == high else f"vanishes in the range [{low:g}, {high:g}]"
                return f"{term.label}{source} {where}, so {term.coordinate!r} would not be coupled."
        return None


@final
class Gear(Coupling):
    """Two shafts: the first of `joints` turns `ratio` times as far as the second.

    The ratio is negative where they turn against each other, as two wheels that mesh: -z2/z1.
    """

    kind: ClassVar[str] = "gear"
    unit: ClassVar[str] = "rad"

    joints: Two
    ratio: Quantity

    def terms(self) -> tuple[Term, ...]:
        first, second = self.joints
        return (Term(first, turns=True), Term(second, -1.0, "ratio", self.ratio, turns=True))


@final
class Planetary(Coupling):
    """A planetary gear with the members `sun`, `ring` and `carrier`, joints on one body.

    `ratio` is that of the teeth of ring and sun: sun + ratio ring = (1 + ratio) carrier. With planets in
    pairs it is negative.
    """

    kind: ClassVar[str] = "planetary"
    unit: ClassVar[str] = "rad"

    sun: Text
    ring: Text
    carrier: Text
    ratio: Quantity

    def terms(self) -> tuple[Term, ...]:
        whole = 1.0 + self.ratio if isinstance(self.ratio, float) else f"1 + ({self.ratio})"
        return (
            Term(self.sun, turns=True),
            Term(self.ring, 1.0, "ratio", self.ratio, turns=True),
            Term(self.carrier, -1.0, "1 + ratio", whole, turns=True),
        )


@final
class Differential(Coupling):
    """A differential: the angles of `left` and `right` are together twice that of the `carrier`."""

    kind: ClassVar[str] = "differential"
    unit: ClassVar[str] = "rad"

    left: Text
    right: Text
    carrier: Text

    def terms(self) -> tuple[Term, ...]:
        sides = (Term(name, turns=True) for name in (self.left, self.right))
        return (*sides, Term(self.carrier, -2.0, turns=True))


@final
class Belt(Coupling):
    """A belt about two pulleys with `radii` (m); a `crossed` one turns them against each other."""

    kind: ClassVar[str] = "belt"
    unit: ClassVar[str] = "m"

    joints: Two
    radii: Pair
    crossed: bool = False

    def terms(self) -> tuple[Term, ...]:
        (first, second), (r1, r2) = self.joints, self.radii
        sign = 1.0 if self.crossed else -1.0
        return (
            Term(first, 1.0, "radii.0", r1, turns=True),
            Term(second, sign, "radii.1", r2, turns=True),
        )


@final
class Rack(Coupling):
    """A pinion with a `radius` (m) on a rack: the `slider` moves by radius times the angle of `joint`."""

    kind: ClassVar[str] = "rack"
    unit: ClassVar[str] = "m"

    joint: Text
    slider: Text
    radius: Quantity

    def terms(self) -> tuple[Term, ...]:
        slider = Term(self.slider, turns=False)
        return (slider, Term(self.joint, -1.0, "radius", self.radius, turns=True))


@final
class Screw(Coupling):
    """A screw: the `slider` moves by the `pitch` (m) with each turn of `joint`; a left-handed one is
    negative."""

    kind: ClassVar[str] = "screw"
    unit: ClassVar[str] = "m"

    joint: Text
    slider: Text
    pitch: Quantity

    def terms(self) -> tuple[Term, ...]:
        slider = Term(self.slider, turns=False)
        return (slider, Term(self.joint, -1.0, "pitch", f"({self.pitch})/(2*pi)", turns=True))


class _ByCoordinate(Coupling):
    """Coefficients by coordinate, in a field that is a table."""

    table: ClassVar[str]

    def terms(self) -> tuple[Term, ...]:
        factors: Mapping[str, Quantity] = getattr(self, self.table)
        return tuple(Term(name, 1.0, f"{self.table}.{name}", x) for name, x in factors.items())


@final
class Cable(_ByCoordinate):
    """A cable over pulleys, whose length stays: `strands` are what each coordinate takes of it.

    The coefficient of a distance is a number of strands, that of an angle the radius of a drum (m).
    """

    kind: ClassVar[str] = "cable"
    table: ClassVar[str] = "strands"
    unit: ClassVar[str] = "m"

    strands: dict[Text, Quantity]


@final
class Linear(_ByCoordinate):
    """Any linear relation: `factors` multiply the coordinates, and their sum stays.

    Such as a differential with a bevel output. The relation has the unit of its first coordinate: behind
    an angle the factor of a distance has the unit 1/m, behind a distance that of an angle m.
    """

    kind: ClassVar[str] = "linear"
    table: ClassVar[str] = "factors"

    factors: dict[Text, Quantity]


@final
class Mimic(Coupling):
    """A joint that follows another one, as in URDF: joint = multiplier leader + offset.

    The multiplier of an angle by a distance has the unit 1/m, that of a distance by an angle m.
    """

    kind: ClassVar[str] = "mimic"

    joint: Text
    leader: Text
    multiplier: Quantity = 1.0

    def terms(self) -> tuple[Term, ...]:
        return (Term(self.joint), Term(self.leader, -1.0, "multiplier", self.multiplier))


KINDS: dict[str, type[Coupling]] = {
    cls.kind: cls for cls in (Belt, Cable, Differential, Gear, Linear, Mimic, Planetary, Rack, Screw)
}
