"""Random mechanisms: trees with all kinds of joints, orientations, loads and sensors.

An equilibrium exists for all values of the parameters. Efforts of joints are unknown, or given
(zero for most) and then as many unknown loads act on the child of the joint: a load
does nothing to the joints further out, and its direction reaches one coordinate after the other, so the
unknowns are never redundant.
"""

import numpy as np

import mbdlft
from mbdlft.base.expression import names, parse
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.joint.kinds import Rotation
from tests import strategies

EDGES = (
    "none",
    "zero gravity",
    "angle near zero",
    "angle near straight",
    "unused parameter",
    "wide angle",
    "accelerated",
    "imposed",
)
MOST_BODIES, MOST_COORDINATES = 12, 14
MOST_TURNS = 4  # half-angles that rotations by angle parameters may cost: models stay small
Entry = float | str
_KINDS = ("revolute", "prismatic", "cylindrical", "universal", "planar", "spherical", "free")
_COUNT = dict(zip(_KINDS, (1, 1, 2, 2, 3, 3, 6), strict=True))
_TURNS = {
    "revolute": (True,),
    "prismatic": (False,),
    "cylindrical": (False, True),
    "universal": (True, True),
    "planar": (False, False, True),
    "spherical": (True,) * 3,
    "free": (False,) * 3 + (True,) * 3,
}
_CLASSES = {
    "revolute": mbdlft.Revolute,
    "prismatic": mbdlft.Prismatic,
    "cylindrical": mbdlft.Cylindrical,
    "universal": mbdlft.Universal,
    "planar": mbdlft.Planar,
    "spherical": mbdlft.Spherical,
    "free": mbdlft.Free,
}
_PORT_SENSORS = (
    mbdlft.Position,
    mbdlft.Velocity,
    mbdlft.Acceleration,
    mbdlft.SmallRotation,
    mbdlft.AngularRate,
    mbdlft.AngularAcceleration,
)


def random_mechanism(seed: int, bodies: int | None = None, edge: str | None = None) -> mbdlft.Scene:
    """A random mechanism; the number of `bodies` (2 to 12) and `edge` are drawn if not given."""
    return _Mechanism(seed, bodies, edge or EDGES[seed % len(EDGES)]).scene()


class _Mechanism(strategies.Draft):
    """A random mechanism in the making."""

    def __init__(self, seed: int, bodies: int | None, edge: str) -> None:
        super().__init__(seed, None, None, edge)
        self.count = bodies or int(self.random.integers(2, MOST_BODIES + 1))
        self.most = int(self.random.integers(1, 7 if self.count <= 4 else 5))
        self.of_kind = {}
        self.loads: list[mbdlft.Force | mbdlft.Torque | mbdlft.Buoyancy] = []
        self.sensors: list = []
        self.coordinates = self.turns = 0
        self.gravity = (0.0, 0.0, 0.0)

    # joints ----------------------------------------------------------------------------------

    def angle(self, *, forced: bool = False) -> Entry:
        """As that of the draft; a number once rotations by parameters have cost enough."""
        source = super().angle(forced=forced)
        used = names(parse(source))
        cost = sum(3 if p.substitution == "quarter-angle" else 1 for p in self.angles(used))
        cost *= 2 if "2*" in str(source) else 1
        if self.turns + cost > MOST_TURNS:
            return self.number(-3.0, 3.0)
        self.turns += cost
        return source

    def angles(self, used: frozenset[str]) -> list[mbdlft.Parameter]:
        return [p for p in self.parameters if p.is_angle and p.name in used]

    def orientation(self) -> tuple[Rotation, ...]:
        count = int(self.random.integers(1, 3)) if self.chance(0.3) else 0
        return tuple(Rotation(axis=self.axis(), angle=self.angle()) for _ in range(count))

    def kind(self, *, first: bool) -> str:
        """A kind of joint that leaves the scene small enough; one body in seven is fixed."""
        left = MOST_COORDINATES - self.coordinates - (0 if first else self.count // 3)
        if first and self.chance(0.35):
            return "free"
        fitting = [kind for kind in _KINDS if _COUNT[kind] <= max(left, 0)]
        if not first and (not fitting or self.chance(0.15)):
            return "fixed"
        light = [kind for kind in fitting if _COUNT[kind] == 1]
        return self.one_of(*fitting, *light, *light) if not self.chance(0.05) else fitting[-1]

    def connect(self, kind: str, name: str, child: str) -> None:
        ends = self.ends(child)
        common = {"name": name, **ends, "orientation": self.orientation()}
        if kind == "fixed":
            self.joints.append(mbdlft.Fixed(**common, axis=self.axis(), position=self.angle()))
            return
        self.coordinates += _COUNT[kind]
        if self.edge == "imposed" and kind != "free" and self.chance(0.4):
            common["imposed"] = True
        passive = "imposed" not in common and (kind == "free" or self.chance(0.3))
        fields = self.coordinates_of(kind, passive=passive)
        joint = _CLASSES[kind](**common, **fields)
        self.joints.append(joint)
        if passive:
            self.hold(joint)

    def coordinates_of(self, kind: str, *, passive: bool) -> dict:
        """Axes and quantities of a joint."""
        fields: dict = {}
        if kind == "universal":
            fields["axis1"] = first = self.axis()
            fields["axis2"] = self.across(first)
        elif kind not in ("spherical", "free"):
            fields["axis"] = self.axis()
        turns = _TURNS[kind]
        each: dict[str, tuple[Entry, ...]] = {
            "stiffness": tuple(self.stiffness(turn) for turn in turns),
            "damping": tuple(self.damping(turn) for turn in turns),
        }
        if kind == "free":
            fields["position"] = tuple(entry.source for entry in self.vector(0.5))
            return fields | each
        each["actuator_inertia"] = tuple(self.actuator(turn) for turn in turns)
        if kind != "spherical":
            each["position"] = tuple(self.angle() if turn else self.place() for turn in turns)
            if kind == "universal" and passive:
                # the direction of the first axis in the child must not depend on parameters
                each["position"] = (each["position"][0], self.number(-1.0, 1.0))
        if passive:
            held = self.chance(0.7)
            each["preload"] = tuple(0.0 if held else self.effort(turn) for turn in turns)
        if len(turns) == 1:
            each = {key: value[0] for key, value in each.items()}
        return fields | each

    def across(self, axis: tuple[float, float, float]) -> tuple[float, float, float]:
        """A direction that is far from parallel to another one."""
        unit = np.array(axis) / np.linalg.norm(axis)
        other = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))]) + 0.3 * unit
        x, y, z = (float(value) for value in other)
        return (x, y, z)

    def stiffness(self, turn: bool) -> Entry:
        kind, low, high = (
            (strategies.TURN_STIFFNESS, 1.0, 50.0) if turn else (strategies.SLIDE_STIFFNESS, 10.0, 500.0)
        )
        return self.strength(self.number(low, high), kind)

    def damping(self, turn: bool) -> Entry:
        kind, low, high = (
            (strategies.TURN_DAMPING, 0.1, 2.0) if turn else (strategies.SLIDE_DAMPING, 1.0, 20.0)
        )
        return self.strength(self.number(low, high), kind)

    def actuator(self, turn: bool) -> Entry:
        if turn and isinstance(self.bodies[-1], mbdlft.PointMass):
            return self.number(0.1, 0.5)  # a point mass does not resist a rotation about itself
        kind, low, high = (strategies.INERTIA, 0.01, 0.5) if turn else (strategies.MASS, 0.1, 2.0)
        return self.strength(self.number(low, high), kind)

    def place(self) -> Entry:
        return self.quantity(self.number(-0.5, 0.5), strategies.LENGTH, rate=0.3).source

    def effort(self, turn: bool) -> Entry:
        return self.quantity(
            self.number(-5.0, 5.0), strategies.TORQUE if turn else strategies.FORCE, rate=0.3
        ).source

    # loads -----------------------------------------------------------------------------------

    def load(self, turn: bool, direction: np.ndarray, frame: str, magnitude: Entry | None) -> None:
        """A force or torque on the last body."""
        body = self.bodies[-1]
        port = self.one_of(body.name, *(f"{body.name}.{p}" for p in body.port_names()))
        x, y, z = (float(value) for value in direction)
        cls = mbdlft.Torque if turn else mbdlft.Force
        name = f"l{len(self.loads) + 1}"
        self.loads.append(
            cls(name=name, port=port, direction=(x, y, z), frame=frame, magnitude=magnitude)
        )

    def hold(self, joint: Joint) -> None:
        """Unknown loads on the child in place of the efforts of its joint."""
        directions = np.array(_in_the_child(joint))
        directions += 0.15 * self.random.normal(size=directions.shape)
        frame = "body"
        if joint.kind in ("spherical", "free"):
            # a turned basis, in the axes of the body or of the scene
            directions = directions @ np.linalg.qr(self.random.normal(size=(3, 3)))[0]
            frame = self.one_of("body", "ground")
        if joint.kind == "universal":
            directions[0] = joint.axis2
        for turn, direction in zip(_TURNS[joint.kind], directions, strict=True):
            self.load(turn, direction, frame, None)
        if joint.kind == "free" and frame == "ground" and self.chance(0.5):
            self.float_instead()

    def float_instead(self) -> None:
        """Buoyancy in place of the first of six loads; the other forces are across gravity."""
        if any(isinstance(g, str) for g in self.gravity) or not any(self.gravity):
            return
        up = np.array(self.gravity) / np.linalg.norm(self.gravity)
        first = len(self.loads) - 6
        for k in (1, 2):
            old = np.array(self.loads[first + k].direction)
            x, y, z = (float(value) for value in old - 0.9 * np.dot(old, up) * up)
            self.loads[first + k] = self.loads[first + k].model_copy(update={"direction": (x, y, z)})
        old = self.loads[first]
        self.loads[first] = mbdlft.Buoyancy(name=old.name, port=old.port)

    def extra_load(self) -> None:
        """A given load on the last body: zero, a number or an expression."""
        kind = self.one_of("force", "torque", "buoyancy")
        frame = self.one_of("body", "ground")
        if kind == "buoyancy":
            body, mass = self.bodies[-1], self.quantity(self.number(0.1, 2.0), strategies.MASS, rate=0.4)
            port = self.one_of(body.name, *(f"{body.name}.{p}" for p in body.port_names()))
            name = f"l{len(self.loads) + 1}"
            self.loads.append(mbdlft.Buoyancy(name=name, port=port, displaced_mass=mass.source))
            return
        value = 0.0 if self.chance(0.3) else self.number(-8.0, 8.0)
        units = strategies.TORQUE if kind == "torque" else strategies.FORCE
        magnitude = self.quantity(value, units, rate=0.4).source
        self.load(kind == "torque", np.array(self.axis()), frame, magnitude)

    # sensors ---------------------------------------------------------------------------------

    def any_port(self) -> str:
        body = self.one_of(*self.bodies)
        return self.one_of(body.name, *(f"{body.name}.{p}" for p in body.port_names()))

    def sensor(self, name: str) -> None:
        if self.chance(0.35):
            joint = self.one_of(*self.joints)
            self.sensors.append(mbdlft.JointWrench(name=name, joint=joint.name))
            return
        cls = self.one_of(
            *_PORT_SENSORS, mbdlft.Accelerometer, mbdlft.Gyro, mbdlft.Momentum, mbdlft.CenterOfMass
        )
        if cls in (mbdlft.Momentum, mbdlft.CenterOfMass):
            self.sensors.append(cls(name=name))
            return
        fields = {"name": name, "port": self.any_port()}
        if cls in _PORT_SENSORS and self.chance(0.5):
            fields["frame"] = self.one_of(*(body.name for body in self.bodies))
        self.sensors.append(cls(**fields))

    # the scene -------------------------------------------------------------------------------

    def all_signals(self) -> dict[str, tuple[str, ...] | None]:
        """The default signals, or all of them with accelerations of the ground, in any order."""
        if self.chance(0.3):
            return {"inputs": None, "outputs": None}
        inputs, outputs = [], []
        for joint in self.joints:
            imposed = getattr(joint, "imposed", False)
            for freedom in joint.freedoms:
                signal = freedom.measures[2] if imposed else freedom.effort
                inputs.append(f"{joint.name}.{signal.name}")
                outputs += [f"{joint.name}.{measure.name}" for measure in freedom.measures]
        inputs += [f"{load.name}.{load.signal.name}" for load in self.loads]
        inputs += [f"ground.acceleration.{axis}" for axis in "xyz" if self.chance(0.4)]
        outputs += [signal.name for sensor in self.sensors for signal in sensor.signals()]
        return {
            "inputs": tuple(map(str, self.random.permutation(inputs))),
            "outputs": tuple(map(str, self.random.permutation(outputs))),
        }

    def scene(self) -> mbdlft.Scene:
        zero = (0.0, 0.0, 0.0)
        self.gravity = zero if self.edge == "zero gravity" else self.acceleration()
        accelerated = self.edge == "accelerated" or (self.edge == "none" and self.chance(0.3))
        acceleration = self.acceleration() if accelerated else zero
        if self.chance(0.4):
            sources = tuple(entry.source for entry in self.vector(0.5))
            self.bodies.append(mbdlft.Ground(ports={"base": sources}))
        for k in range(1, self.count + 1):
            kind = self.kind(first=k == 1)
            self.body(f"b{k}")
            while kind == "free" and self.bodies[-1].kind == "point_mass":
                self.bodies.pop()  # nothing holds the rotations of a point mass
                self.body(f"b{k}")
            self.connect(kind, f"j{k}", f"b{k}")
            if self.chance(0.2):
                self.extra_load()
        for k in range(int(self.random.integers(0, 4))):
            self.sensor(f"s{k + 1}")
        if self.edge == "unused parameter":
            self.parameters.append(mbdlft.Parameter("unused", 2.0, percent=10))
        return mbdlft.Scene(
            name=f"mechanism {self.seed}",
            gravity=self.gravity,
            acceleration=acceleration,
            constants=self.constants,
            parameters=tuple(self.parameters),
            bodies=tuple(self.bodies),
            joints=tuple(self.joints),
            loads=tuple(self.loads),
            sensors=tuple(self.sensors),
            **self.all_signals(),
        )


def _in_the_child(joint: Joint) -> list[tuple[float, ...] | np.ndarray]:
    """Unit directions in the axes of the child, one for each coordinate: what holds it there."""
    if joint.kind in ("spherical", "free"):
        return [*np.eye(3)] * (2 if joint.kind == "free" else 1)
    if joint.kind == "universal":
        second = np.array(joint.axis2) / np.linalg.norm(joint.axis2)
        first = np.array(joint.axis1) / np.linalg.norm(joint.axis1)
        across = first - np.dot(first, second) * second
        c, s = np.cos(joint.position[1]), np.sin(joint.position[1])
        return [second, (c * across - s * np.cross(second, across)) / np.linalg.norm(across)]
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    if joint.kind != "planar":
        return [axis] * len(_TURNS[joint.kind])
    x = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    x = x / np.linalg.norm(x)
    return [x, np.cross(axis, x), axis]
