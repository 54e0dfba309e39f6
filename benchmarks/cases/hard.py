"""The hard cases: a scene, a value of its parameters, and the same system with 50 digits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath as mp

import mbdlft
from benchmarks.cases.digits import Motion, Truth, scene_truth, truth
from mbdlft.base.parameter import Substitution
from mbdlft.multibody.body.elastic import FlexibleBody, Mode

GRAVITY = (0.0, 0.0, -9.81)
NEAR = 1e-6  # distance from something singular


@dataclass(frozen=True)
class Case:
    """One scene at one value of its parameters; `closed` has its motion where it has a closed form."""

    name: str
    scene: mbdlft.Scene
    values: dict[str, float]
    closed: tuple[Callable[[Sequence[Any]], Motion], tuple[float, ...]] | None = None

    def truth(self) -> Truth:
        """[A B] with 50 digits, and its condition."""
        if self.closed is None:
            return scene_truth(self.scene, self.values)
        motion, data = self.closed
        with mp.workdps(50):
            return truth(motion, [mp.mpf(value) for value in data])


UNITS = {"m": "kg", "L": "m", "J": "kg m^2", "k": "N m/rad", "w": "rad/s"}


def parameter(name: str, nominal: float, percent: float = 20.0) -> mbdlft.Parameter:
    """A parameter whose unit follows from its letter."""
    return mbdlft.Parameter(name, nominal, percent=percent, unit=UNITS[name[0]])


def links(
    name: str,
    masses: Sequence[float | str],
    lengths: Sequence[float | str],
    positions: Sequence[float | str],
    parameters: Sequence[mbdlft.Parameter],
    *,
    spatial: bool = False,
    inertia: Sequence[float] | None = None,
    stiffness: Sequence[float | str] = (),
) -> mbdlft.Scene:
    """Uniform links on revolute joints about x, or about x and z in turn."""
    bodies = []
    inertia = [0.1] * len(masses) if inertia is None else inertia
    for k, (mass, length) in enumerate(zip(masses, lengths, strict=True)):
        bodies.append(
            mbdlft.RigidBody(
                name=f"b{k}",
                mass=mass,
                center_of_mass=(0, f"0.5*{length}", 0),
                inertia=mbdlft.Inertia(xx=inertia[k], yy=0.1 * inertia[k], zz=inertia[k]),
                ports={"tip": (0, length, 0)},
            )
        )
    joints = [
        mbdlft.Revolute(
            name=f"j{k}",
            parent=f"b{k - 1}.tip" if k else "ground",
            child=f"b{k}",
            axis=(0, 0, 1) if spatial and k % 2 else (1, 0, 0),
            position=positions[k],
            stiffness=stiffness[k] if stiffness else 0.0,
        )
        for k in range(len(masses))
    ]
    return mbdlft.Scene(
        name=name, gravity=GRAVITY, parameters=list(parameters), bodies=bodies, joints=joints
    )


def mass_ratio(first: float, last: float) -> Case:
    """Two links, one a thousand million times as heavy as the other."""
    scene = links(
        "ratio",
        ["m", last],
        ["L", 0.8],
        ["0.5", "t"],
        [parameter("m", first), parameter("L", 1.0), mbdlft.Angle("t", 40.0, 0.0, 80.0)],
        inertia=[0.1 * first, 0.1 * last],
    )
    return Case(f"masses {first:.0e} and {last:.0e} kg", scene, {"m": 0.9 * first, "L": 1.1, "t": 63.0})


def sizes(first: float = 1.0, last: float = 1e-6) -> Case:
    """Links of a micrometer, a kilometer and a meter in one chain."""
    scene = links(
        "sizes",
        ["m", 2.0, 1.0],
        [first, "L", last],
        ["0.4", "t", "0.7"],
        [parameter("m", 1.0), parameter("L", 1e3), mbdlft.Angle("t", 30.0, 0.0, 60.0)],
        inertia=[0.1 * first**2, 1e5, 0.1 * last**2],
    )
    return Case(
        f"links of {first:.0e}, 1e+03 and {last:.0e} m", scene, {"m": 1.1, "L": 1.13e3, "t": 44.0}
    )


def light_tip() -> Case:
    """A link of a microgram and a micrometer at the end of one of a ton and a kilometer."""
    scene = links(
        "tip",
        ["m", 1e-9],
        ["L", 1e-6],
        ["0.4", "t"],
        [parameter("m", 1e3), parameter("L", 1e3), mbdlft.Angle("t", 30.0, 0.0, 60.0)],
        inertia=[1e8, 1e-22],
    )
    return Case("1e-9 kg of 1 um at 1e3 kg of 1 km", scene, {"m": 1.1e3, "L": 1.13e3, "t": 44.0})


def one_size(length: float) -> Case:
    """Three links of one extreme size."""
    scene = links(
        "size",
        ["m", 2.0, 1.0],
        ["L", length, length],
        ["0.4", "t", "0.7"],
        [parameter("m", 1.0), parameter("L", length), mbdlft.Angle("t", 30.0, 0.0, 60.0)],
        inertia=[0.1 * length**2] * 3,
    )
    return Case(f"links of {length:.0e} m", scene, {"m": 1.1, "L": 1.13 * length, "t": 44.0})


def no_inertia() -> Case:
    """Mass-less links, a point mass at each end."""
    bodies: list[Any] = []
    joints: list[Any] = []
    for k, length in enumerate(("L", "0.7", "0.5")):
        bodies += [
            mbdlft.RigidBody(
                name=f"rod{k}", mass=0, inertia=mbdlft.Inertia(xx=0), ports={"tip": (0, length, 0)}
            ),
            mbdlft.PointMass(name=f"bob{k}", mass="m" if k == 2 else 0.4),
        ]
        joints += [
            mbdlft.Revolute(
                name=f"j{k}",
                parent=f"rod{k - 1}.tip" if k else "ground",
                child=f"rod{k}",
                axis=(1, 0, 0),
                position="t" if k == 1 else 0.3,
            ),
            mbdlft.Fixed(name=f"f{k}", parent=f"rod{k}.tip", child=f"bob{k}"),
        ]
    parameters = [parameter("m", 1.0), parameter("L", 1.0), mbdlft.Angle("t", 40.0, 0.0, 80.0)]
    scene = mbdlft.Scene(
        name="rods", gravity=GRAVITY, parameters=parameters, bodies=bodies, joints=joints
    )
    return Case("bodies without inertia", scene, {"m": 1.2, "L": 0.8, "t": 77.0})


def half_angle(distance: float, substitution: Substitution = "half-angle") -> Case:
    """A joint angle up to the singular point of its half-angle, but for `distance` in degrees."""
    reach = 180.0 - distance
    angle = mbdlft.Angle("t", 0.0, -reach, reach, substitution=substitution)
    scene = links("half", ["m", 1.0], [1.0, 0.8], ["0.5", "t"], [parameter("m", 1.0), angle])
    return Case(
        f"angle {distance:.0e} deg from the singular point", scene, {"m": 1.1, "t": 180.0 - distance}
    )


def collinear(inertia: float) -> Case:
    """Two joints with one axis, and next to nothing between them."""
    small = mbdlft.Inertia(xx="J")
    bodies = [
        mbdlft.RigidBody(name="ring", mass=0, inertia=small),
        mbdlft.RigidBody(
            name="arm", mass="m", center_of_mass=(0, 0.4, 0), inertia=mbdlft.Inertia(xx=0.5)
        ),
    ]
    joints = [
        mbdlft.Revolute(name="inner", parent="ground", child="ring", axis=(1, 0, 0), position=0.3),
        mbdlft.Revolute(
            name="outer", parent="ring", child="arm", axis=(1, 0, 0), position="t", stiffness=2.0
        ),
    ]
    parameters = [parameter("J", inertia), parameter("m", 1.0), mbdlft.Angle("t", 20.0, 0.0, 60.0)]
    scene = mbdlft.Scene(
        name="ring", gravity=GRAVITY, parameters=parameters, bodies=bodies, joints=joints
    )
    return Case(
        f"mass matrix singular but for {inertia:.0e} kg m^2",
        scene,
        {"J": 1.1 * inertia, "m": 0.9, "t": 51.0},
    )


def stiff() -> Case:
    """A joint of 1e9 N m/rad between free ones."""
    scene = links(
        "stiff",
        ["m", 1.0, 0.5],
        [1.0, 0.7, 0.4],
        ["0.2", "t", "0.4"],
        [parameter("m", 1.0), parameter("k", 1e9), mbdlft.Angle("t", 30.0, 0.0, 60.0)],
        stiffness=[0.0, "k", 0.0],
    )
    return Case("a joint of 1e9 N m/rad beside free ones", scene, {"m": 1.1, "k": 1.17e9, "t": 7.0})


def wide(percent: float) -> Case:
    """Masses and lengths in almost all of (0, 2) times their nominal values."""
    scene = links(
        "wide",
        ["m", 1.0],
        ["L", 0.8],
        ["0.5", "t"],
        [parameter("m", 1.0, percent), parameter("L", 1.0, percent), mbdlft.Angle("t", 40.0, 0.0, 80.0)],
    )
    low = 1.0 - 0.01 * percent
    return Case(f"ranges of +-{percent:g} %", scene, {"m": low, "L": low, "t": 80.0})


def bifurcation(distance: float) -> Case:
    """An inverted pendulum whose spring balances gravity but for `distance`."""
    bodies = [mbdlft.PointMass(name="bob", mass="m", ports={"foot": (0, 0, -1.0)})]
    joints = [
        mbdlft.Revolute(name="pivot", parent="ground", child="bob.foot", axis=(1, 0, 0), stiffness="k")
    ]
    parameters = [parameter("m", 1.0), parameter("k", 9.81)]
    scene = mbdlft.Scene(
        name="buckling", gravity=GRAVITY, parameters=parameters, bodies=bodies, joints=joints
    )
    return Case(
        f"{distance:.0e} from the load of bifurcation",
        scene,
        {"m": 1.1, "k": 9.81 * 1.1 * (1.0 + distance)},
    )


def many_channels(count: int = 9) -> Case:
    """All masses, lengths and angles of a chain in space: a Delta of more than 500 channels."""
    parameters = [
        p
        for k in range(count)
        for p in (
            parameter(f"m{k}", 2.0),
            parameter(f"L{k}", 1.0),
            mbdlft.Angle(f"t{k}", 20.0 + 10 * (k % 6), 0.0, 80.0),
        )
    ]
    scene = links(
        "channels",
        *([f"{letter}{k}" for k in range(count)] for letter in "mLt"),
        parameters,
        spatial=True,
    )
    values = {p.name: float(0.3 * p.low + 0.7 * p.high) for p in parameters}
    return Case(f"chain of {count} links in space, {3 * count} parameters", scene, values)


def long_chain(count: int = 100, *, inverted: bool = False) -> Case:
    """Rods without mass with equal point masses, straight down or up."""
    bodies: list[Any] = []
    joints: list[Any] = []
    for k in range(count):
        bodies.append(
            mbdlft.RigidBody(
                name=f"b{k}",
                mass="m" if k == count - 1 else 1.0,
                center_of_mass=(0, 0, "-L" if k == 0 else -1.0),
                inertia=mbdlft.Inertia(xx=0),
                ports={"tip": (0, 0, "-L" if k == 0 else -1.0)},
            )
        )
        joints.append(
            mbdlft.Revolute(
                name=f"j{k}",
                parent=f"b{k - 1}.tip" if k else "ground",
                child=f"b{k}",
                axis=(1, 0, 0),
                position="180*deg" if inverted and k == 0 else 0.0,
            )
        )
    scene = mbdlft.Scene(
        name="long",
        gravity=GRAVITY,
        bodies=bodies,
        joints=joints,
        parameters=[parameter("m", 1.0), parameter("L", 1.0)],
    )
    sign = -1 if inverted else 1

    def motion(data: Sequence[Any]) -> Motion:
        """In absolute angles M_ij = l_i l_j (mass outboard of both), K_i = g l_i (mass outboard)."""
        m, L, g = data
        lengths = [L] + [mp.mpf(1)] * (count - 1)
        outboard = [m + (count - 1 - k) for k in range(count)]
        # relative angles: sums over all absolute ones that follow
        M = _tails(
            [[lengths[i] * lengths[j] * outboard[max(i, j)] for j in range(count)] for i in range(count)]
        )
        K = _tails(
            [
                [sign * g * lengths[i] * outboard[i] if i == j else mp.mpf(0) for j in range(count)]
                for i in range(count)
            ]
        )
        return Motion(M, [[mp.mpf(0)] * count for _ in range(count)], K)

    name = f"{count} links {'standing' if inverted else 'hanging'}"
    return Case(name, scene, {"m": 1.15, "L": 0.9}, (motion, (1.15, 0.9, 9.81)))


def _tails(matrix: list[list[Any]]) -> list[list[Any]]:
    """S' X S with S the lower triangle of ones: sums over all rows and columns from i, j on."""
    n = len(matrix)
    total = [[mp.mpf(0)] * (n + 1) for _ in range(n + 1)]
    for i in reversed(range(n)):
        for j in reversed(range(n)):
            total[i][j] = matrix[i][j] + total[i + 1][j] + total[i][j + 1] - total[i + 1][j + 1]
    return [row[:n] for row in total[:n]]


def decades() -> Case:
    """A hinged flexible body with modes of 1e-2 to 1e6 rad/s."""
    frequencies = (1e-2, 1.0, 1e3, 1e6)
    participation = (2.0, 1.0, 0.5, 0.3)
    modes = tuple(
        Mode(frequency="w" if k == 1 else f, damping=0.0, participation=(0, 0, 0, p, 0, 0))
        for k, (f, p) in enumerate(zip(frequencies, participation, strict=True))
    )
    panel = FlexibleBody(
        name="panel",
        mass=3.0,
        center_of_mass=(0, 0, 0),
        inertia=mbdlft.Inertia(xx="J", yy=8, zz=8),
        modes=modes,
    )
    scene = mbdlft.Scene(
        name="decades",
        parameters=[parameter("J", 10.0), parameter("w", 1.0)],
        bodies=[panel],
        joints=[
            mbdlft.Revolute(name="hinge", parent="ground", child="panel", axis=(1, 0, 0), stiffness=5.0)
        ],
    )

    def motion(data: Sequence[Any]) -> Motion:
        J, k = data[0], data[1]
        rates, p = data[2:6], data[6:]
        zero = mp.mpf(0)
        M = [[J, *p], *([p[i], *(mp.mpf(int(i == j)) for j in range(4))] for i in range(4))]
        K = [
            [k, *[zero] * 4],
            *([zero, *(rates[i] ** 2 if i == j else zero for j in range(4))] for i in range(4)),
        ]
        return Motion(M, [[zero] * 5 for _ in range(5)], K)

    data = (10.9, 5.0, 1e-2, 1.07, 1e3, 1e6, *participation)
    return Case(
        "flexible body, frequencies of 1e-2 to 1e6 rad/s", scene, {"J": 10.9, "w": 1.07}, (motion, data)
    )


def oscillator(damping: float) -> mbdlft.Scene:
    """A mass m on a spring of 1 N/m."""
    slide = mbdlft.Prismatic(
        name="slide", parent="ground", child="block", axis=(1, 0, 0), stiffness=1.0, damping=damping
    )
    return mbdlft.Scene(
        name="oscillator",
        parameters=[parameter("m", 1.0)],
        bodies=[mbdlft.PointMass(name="block", mass="m")],
        joints=[slide],
    )


def absorber(mass: float) -> mbdlft.Scene:
    """A mass m on a spring of 2 N/m, and on it a light one with the frequency 1 rad/s."""
    return mbdlft.Scene(
        name="absorber",
        parameters=[parameter("m", 1.0)],
        bodies=[mbdlft.PointMass(name="block", mass="m"), mbdlft.PointMass(name="light", mass=mass)],
        joints=[
            mbdlft.Prismatic(name="slide", parent="ground", child="block", axis=(1, 0, 0), stiffness=2.0),
            mbdlft.Prismatic(name="tuned", parent="block", child="light", axis=(1, 0, 0), stiffness=mass),
        ],
        inputs=["slide.force"],
        outputs=["slide.position"],
    )


def sagging(imperfection: float) -> mbdlft.Scene:
    """An inverted pendulum with the spring of its bifurcation, relaxed at a small angle."""
    return mbdlft.Scene(
        name="sagging",
        gravity=GRAVITY,
        bodies=[mbdlft.PointMass(name="bob", mass=1.0, ports={"foot": (0, 0, -1.0)})],
        joints=[
            mbdlft.Revolute(
                name="pivot",
                parent="ground",
                child="bob.foot",
                axis=(1, 0, 0),
                stiffness=-GRAVITY[2],
                position=imperfection,
                preload=0,
            )
        ],
    )


CASES = (
    mass_ratio(1e9, 1.0),
    mass_ratio(1.0, 1e9),
    sizes(),
    sizes(1e-6, 1.0),
    light_tip(),
    one_size(1e-6),
    one_size(1e3),
    no_inertia(),
    half_angle(1e-2),
    collinear(1e-6),
    collinear(1e-12),
    stiff(),
    wide(99.0),
    wide(99.99),
    bifurcation(1e-9),
    decades(),
    long_chain(20),
    long_chain(20, inverted=True),
)
LARGE = (many_channels(), long_chain(), long_chain(inverted=True))
