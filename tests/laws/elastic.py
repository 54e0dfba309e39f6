"""Small elastic scenes for laws, and their equations of motion as matrices."""

from typing import NamedTuple

import casadi as ca
import numpy as np

import mbdlft
from mbdlft.multibody.body import Body
from mbdlft.multibody.joint import Joint
from mbdlft.problem.equations import equation_function, load_value, physical_symbols
from mbdlft.problem.trim import trim_efforts
from tests import kit

GRAVITY = 9.81


class Motion(NamedTuple):
    """M qddot + D qdot + K q = u of all joints and elastic bodies, (n, n) each."""

    M: np.ndarray
    D: np.ndarray
    K: np.ndarray


def motion(scene: mbdlft.Scene) -> Motion:
    """Slopes of the residual at the nominal equilibrium, by automatic differentiation."""
    e = mbdlft.assemble(scene)
    points = np.array([[p.nominal for p in e.parameters]])
    efforts, _ = trim_efforts(e, points)
    symbols, p, cosine, sine = physical_symbols(e.parameters)
    n = e.degrees_of_freedom
    residual, _ = equation_function(e)(e.xdot, e.x, e.z, e.u, load_value(e, p), p, cosine, sine)
    forces = residual[n : 2 * n]
    slopes = [ca.jacobian(forces, part) for part in (e.xdot[n:], e.x[n:], e.x[:n])]
    at = ca.Function("slopes", [e.xdot, e.x, e.z, e.u, symbols], [ca.densify(s) for s in slopes])
    zero = [np.zeros(s.numel()) for s in (e.xdot, e.x, e.z)]
    M, D, K = (value.full() for value in at(*zero, efforts[0], points[0]))
    return Motion(M, D, K)


def beam(name: str = "beam", elements: int = 3, **given: object) -> mbdlft.Beam:
    """One meter, one kilogram per meter, 1 000 N m^2; elements, or modes with or without stations."""
    data = {"length": 1.0, "density": 1.0, "area": 1.0, "modulus": 1e3, "I_y": 1.0, "I_z": 1.0}
    if not given.get("modes") or "stations" in given:
        data["elements"] = elements
    return mbdlft.Beam(**{"name": name, "deformations": ("bending_z",), **data, **given})


def lever(angle: float, prestress: str | None = "neglected", **given: object) -> mbdlft.Scene:
    """A beam with a mass at its tip on a hinge about y, held at an angle (deg) from the horizontal."""
    return kit.scene(
        "lever",
        beam(prestress=prestress, **given),
        kit.point("bob", 1.0),
        kit.hinge("hinge", "ground", "beam", (0, 1, 0), position=float(np.radians(angle))),
        kit.weld("end", "beam.tip", "bob"),
        gravity=(0, 0, -GRAVITY),
    )


def beside_the_tip() -> mbdlft.Scene:
    """A clamped beam that bends and twists, and carries a body whose center is beside its tip."""
    every = beam(
        deformations=("torsion", "bending_y", "bending_z"),
        shear_modulus=1e3,
        torsion_constant=1.0,
        prestress="neglected",
    )
    weight = kit.body(
        "weight", 2.0, (0.2, 0.3, 0.25), about="center_of_mass", center_of_mass=(0.3, 0.5, 0.4)
    )
    return kit.scene(
        "beside the tip",
        every,
        weight,
        kit.weld("root", "ground", "beam"),
        kit.weld("end", "beam.tip", "weight"),
        gravity=(0.0, 2.0, -GRAVITY),
    )


def segments(count: int, angle: float = 0.0, bending: float = 1e3) -> mbdlft.Scene:
    """The lever as rigid rods on springs of EI/h, held by their preloads.

    The first rod and the last are half as long, so that the springs stand in the middle of what they
    bend; the hinge is at the root.
    """
    h = 1.0 / count
    lengths = [h / 2, *[h] * (count - 1), h / 2]
    bodies: list[Body] = []
    joints: list[Joint] = []
    for k, length in enumerate(lengths):
        bodies.append(
            kit.body(
                f"rod{k}",
                length,
                yy=length**3 / 12.0,
                center_of_mass=(length / 2, 0, 0),
                ports={"tip": (length, 0, 0)},
            )
        )
        joints.append(
            kit.hinge(
                f"j{k}",
                f"rod{k - 1}.tip" if k else "ground",
                f"rod{k}",
                (0, 1, 0),
                position=0.0 if k else float(np.radians(angle)),
                stiffness=bending / h if k else 0.0,
            )
        )
    bodies.append(kit.point("bob", 1.0))
    joints.append(kit.weld("end", f"rod{count}.tip", "bob"))
    return kit.scene("rods", *bodies, *joints, gravity=(0, 0, -GRAVITY))


PANEL_PARAMETERS = [
    mbdlft.Parameter("f", 4.0, percent=20, unit="rad/s"),
    mbdlft.Parameter("xi", 0.02, percent=50, unit="1"),
    mbdlft.Parameter("p", 1.5, percent=20),
    mbdlft.Parameter("s", 0.4, percent=30),
    mbdlft.Parameter("m", 9.0, percent=20, unit="kg"),
    mbdlft.Parameter("c", 0.8, percent=20, unit="m"),
    mbdlft.Parameter("J", 6.0, percent=20, unit="kg m^2"),
    mbdlft.Parameter("mt", 0.7, percent=40, unit="kg"),
]


def panel() -> mbdlft.Scene:
    """A flexible body on a hinge about z with a mass at its tip: every quantity is a parameter."""
    zero = (0.0, 0.0, 0.0)
    first = (0.0, "p", 0.0, 0.0, 0.0, "1.2*p")
    second = (0.0, 0.6, 0.0, 0.0, 0.0, -0.3)
    return kit.scene(
        "panel",
        *PANEL_PARAMETERS,
        mbdlft.FlexibleBody(
            name="panel",
            mass="m",
            center_of_mass=("c", 0, 0),
            inertia=mbdlft.Inertia(zz="J"),
            ports={"tip": (2.0, 0, 0)},
            modes=(
                mbdlft.Mode(
                    frequency="f",
                    damping="xi",
                    participation=first,
                    shapes={"tip": (0.0, "s", 0.0, 0.0, 0.0, 0.3)},
                ),
                mbdlft.Mode(
                    frequency=31.0,
                    damping=0.01,
                    participation=second,
                    shapes={"tip": (0.0, -0.5, 0.0, *zero)},
                ),
            ),
        ),
        kit.point("bob", "mt"),
        kit.hinge("hinge", "ground", "panel", (0, 0, 1)),
        kit.weld("end", "panel.tip", "bob"),
        outputs=("hinge.angle",),
    )


def panel_matrices(v: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """A and B of the panel from its kinetic energy: rigid, coupling and tip in (theta, eta1, eta2)."""
    rotation = np.array([1.2 * v["p"], -0.3])
    at_tip = np.array([2.0, v["s"], -0.5])  # displacement of the tip for each coordinate
    M = np.zeros((3, 3))
    M[0, 0] = v["J"] + v["m"] * v["c"] ** 2
    M[0, 1:] = M[1:, 0] = rotation
    M[1:, 1:] = np.eye(2)
    M += v["mt"] * np.outer(at_tip, at_tip)
    w = np.array([0.0, v["f"], 31.0])
    damping = np.array([0.0, v["xi"], 0.01])
    A, B = np.zeros((6, 6)), np.zeros((6, 1))
    A[:3, 3:] = np.eye(3)
    A[3:, :3] = -np.linalg.solve(M, np.diag(w**2))
    A[3:, 3:] = -np.linalg.solve(M, np.diag(2.0 * damping * w))
    B[3:, 0] = np.linalg.inv(M)[:, 0]
    return A, B


def free_beam() -> mbdlft.Scene:
    """A beam that bends in two planes and twists, on a free rigid body, pushed at its tip."""
    slender = beam(
        area=1.0,
        shear_modulus=3e2,
        torsion_constant=2.0,
        I_y=1.0,
        I_z=1.7,
        elements=2,
        deformations=("axial", "torsion", "bending_y", "bending_z"),
        stiffness_damping=1e-3,
    )
    return kit.scene(
        "free_beam",
        kit.body("hub", 2.0, (1.0, 1.5, 2.0)),
        slender,
        kit.free("flight", "ground", "hub"),
        kit.weld("root", "hub", "beam", (0, 0, 1), position=0.4),
        kit.force("push", "beam.tip", (0, 0.6, 0.8), frame="ground", magnitude=0),
        mbdlft.Momentum(name="momentum"),
        mbdlft.CenterOfMass(name="center"),
        inputs=("push.force",),
        outputs=tuple(
            f"{name}.{axis}"
            for name in ("momentum.linear", "momentum.angular", "center")
            for axis in "xyz"
        ),
    )
