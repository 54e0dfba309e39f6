"""The scene: the description of a system by its user, in Python or as a TOML file."""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Annotated, Any, ClassVar, Self, final

from pydantic import BeforeValidator, Field, InstanceOf, field_validator, model_validator

from mbdlft.base.description import Axis, Description, Many, Name, Number, Prose, Quantity, Text, Vector
from mbdlft.base.display import heading, table
from mbdlft.base.errors import SceneError, naming
from mbdlft.base.expression import BUILTIN_CONSTANTS, FUNCTIONS, Literal
from mbdlft.base.parameter import Parameter, is_finite
from mbdlft.base.unit import in_si, parse_unit
from mbdlft.multibody.body import Body
from mbdlft.multibody.contact import Contact, Patch
from mbdlft.multibody.coupling import Coupling
from mbdlft.multibody.force import Load, Tire, Wheel
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.sensor import Sensor

ALL, NEEDED = "all", "needed"  # which states the linear model has
UNKNOWN = "unknown"  # a component of the acceleration that the trim solves for


@final
class Constant(Description):
    """A named number with a unit."""

    noun: ClassVar[str] = "constant"

    value: Number
    unit: Text = "1"


def _checked(constants: Any) -> Any:
    """The constants; a SceneError for the first that is not a finite number with a known unit."""
    for name, value in constants.items() if isinstance(constants, Mapping) else ():
        if not (isinstance(value, Constant) or is_finite(value)):
            raise SceneError(
                f"constant {name!r}: expected a finite number, or a Constant with a unit (in TOML "
                f"a table with value and unit), got {value!r}."
            )
        if isinstance(value, Constant):
            with naming(f"constant {name!r}", SceneError):
                parse_unit(value.unit)
    return constants


Constants = Annotated[dict[Text, Number | InstanceOf[Constant]], BeforeValidator(_checked)]


@final
class Spin(Description):
    """A steady rotation of the scene's frame about an `axis` through its origin, at `rate` (rad/s)."""

    noun: ClassVar[str] = "spin"

    axis: Axis
    rate: Quantity


@final
class Fit(Description):
    """Guaranteed bounds of the errors of positions that `fit_positions` has fitted to the equilibrium.

    The bounds hold for all values of the parameters: `bounds` has those of positions (rad, m) by
    coordinate, such as ``hinge.angle``, and those of the efforts (N m, N) and force densities (N/m) at
    these positions by input. `tolerance` is the one that the user asked for.
    """

    noun: ClassVar[str] = "fit"

    tolerance: Number
    bounds: dict[Text, Number]

    @model_validator(mode="after")
    def _are_bounds(self) -> Self:
        for name, bound in {"tolerance": self.tolerance, **self.bounds}.items():
            if not bound >= 0.0:
                raise SceneError(f"{name}: expected a number that is not negative, got {bound:g}.")
        return self


@final
class Scene(Description):
    """Bodies connected by joints in a tree on the ground, in an accelerated or spinning frame.

    Parameters
    ----------
    name : str
    description : str, optional
    gravity : three numbers or expressions (m/s^2)
        Components in the axes of the ground, which are those of the scene.
    acceleration : three numbers or expressions (m/s^2)
        Uniform acceleration of the frame of the scene; it acts as minus gravity. A component that is
        ``unknown`` is solved for by the trim, as an effort is.
    velocity : three numbers or expressions (m/s)
        Steady velocity of the frame of the scene over the ground, on which `contacts` stand.
    spin : `Spin`, optional
        Steady rotation of the frame of the scene.
    constants : mapping of names to numbers, or to `Constant` with a unit
    parameters : sequence of `Parameter` and `Angle`
    bodies : sequence of bodies
    joints : sequence of joints
    loads : sequence of loads
    sensors : sequence of sensors
    loops : sequence of `Loop`
        Closures of kinematic loops.
    couplings : sequence of `Coupling`
        Gears, belts, racks, screws, cables between coordinates of joints.
    contacts : sequence of `Contact`
        Wheels and balls that roll on the ground, and knife edges.
    fit : `Fit`, optional
        Written by `fit_positions`: the positions are those of the equilibrium within these bounds only.
    inputs, outputs : sequence of str
        Signals of the linear model, such as ``shoulder.torque``. By default the inputs are all joint
        efforts and loads, and the outputs all joint positions and sensors.
    states : str
        ``all``, or ``needed``: only states on which the inputs act and on which the outputs depend, for
        some values of the parameters. The transfer is the same.

    Numbers in expressions are in SI units (rad for angles); a name stands for a value with its own unit.
    """

    noun: ClassVar[str] = "scene"

    name: Name
    description: Prose = ""
    gravity: Vector = (0.0, 0.0, 0.0)
    acceleration: Vector = (0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    spin: Spin | None = None
    constants: Constants = {}
    parameters: Many[InstanceOf[Parameter]] = ()
    bodies: Many[InstanceOf[Body]] = ()
    joints: Many[InstanceOf[Joint]] = ()
    loads: Many[InstanceOf[Load]] = ()
    sensors: Many[InstanceOf[Sensor]] = ()
    loops: Many[InstanceOf[Loop]] = ()
    couplings: Many[InstanceOf[Coupling]] = ()
    contacts: Many[InstanceOf[Contact]] = ()
    fit: Fit | None = None
    inputs: Annotated[Many[Name] | None, Field(min_length=1)] = None
    outputs: Annotated[Many[Name] | None, Field(min_length=1)] = None
    states: str = ALL

    @field_validator("states")
    @classmethod
    def _states_are_known(cls, states: str) -> str:
        if states not in (ALL, NEEDED):
            raise SceneError(f"states: expected {ALL!r} or {NEEDED!r}, got {states!r}.")
        return states

    @model_validator(mode="after")
    def _names_are_unique(self) -> Self:
        values = [*(p.name for p in self.parameters), *self.constants]
        check_value_names("parameter or constant", values)
        check_unique("body", [body.name for body in self.bodies])
        kinds = ("joints", "loads", "sensors", "loops", "couplings", "contacts")
        with_signals = [item.name for kind in kinds for item in getattr(self, kind)]
        check_unique("joint", [joint.name for joint in self.joints])
        check_unique("joint, load, sensor, loop, coupling or contact", with_signals)
        check_unique("input", self.inputs or ())
        check_unique("output", self.outputs or ())
        if UNKNOWN in self.acceleration and UNKNOWN in values:
            raise SceneError(
                f"acceleration: {UNKNOWN!r} stands for a component that the trim solves for, and a "
                "parameter or constant has this name. Give that another name."
            )
        for name in [*(body.name for body in self.bodies), *with_signals]:
            if "." in name:
                raise SceneError(
                    f"the name {name!r} has a dot; dots separate a body "
                    "from its port and a joint from its signals."
                )
        return self

    @property
    def touches(self) -> tuple[Contact, ...]:
        """The contacts, and the patches of tires."""
        tires = [load for load in self.loads if isinstance(load, Tire) and load.patch]
        patches = [Patch(name=t.name, port=t.patch, normal=t.normal, tire=t) for t in tires]
        return (*self.contacts, *patches)

    @property
    def rolling(self) -> tuple[Contact | Load, ...]:
        """What rolls, or slides on a knife edge: contacts, and wheels that are loads."""
        return (*self.contacts, *(load for load in self.loads if isinstance(load, Wheel)))

    def __repr__(self) -> str:
        return f"<Scene {self.name!r}: {self._sizes()}>"

    def _repr_html_(self) -> str:
        text = heading(self.name, self.description) + heading("", self._sizes())
        ranges = ((p.name, p.nominal, p.low, p.high, p.unit, p.role) for p in self.parameters)
        text += table(("parameter", "nominal", "low", "high", "unit", "role"), ranges)
        joined = ((j.name, j.kind, j.parent, j.child) for j in self.joints)
        return text + table(("joint", "kind", "parent", "child"), joined)

    def _sizes(self) -> str:
        kinds = ("bodies", "joints", "loads", "sensors", "loops", "couplings", "contacts", "parameters")
        counts = {kind: len(getattr(self, kind)) for kind in kinds}
        return ", ".join(f"{count} {kind}" for kind, count in counts.items() if count)

    def constant_values(self) -> dict[str, float]:
        """Constants in SI units by name, with the built-in ones."""
        values = dict(BUILTIN_CONSTANTS)
        for name, constant in self.constants.items():
            if isinstance(constant, Constant):
                values[name] = _in_si(repr(float(constant.value)), constant.unit)
            else:
                values[name] = constant
        return values


@cache
def _in_si(number: str, unit: str) -> Literal:
    return Literal(in_si(number, parse_unit(unit)))


def check_value_names(what: str, names: Sequence[str]) -> None:
    """Raise a SceneError for a name that is given twice or cannot stand in an expression."""
    check_unique(what, names)
    reserved = {*BUILTIN_CONSTANTS, *FUNCTIONS}
    for name in names:
        if name in reserved or not name.isidentifier():
            raise SceneError(
                f"{name!r} cannot name a {what}. Use letters, digits and underscores, and none of "
                f"{', '.join(sorted(reserved))}."
            )


def check_unique(what: str, names: Sequence[str]) -> None:
    """Raise a SceneError for a name that is given twice."""
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise SceneError(f"{what} {twice[0]!r} is given twice.")
