"""A hub with beams on sprung hinges, one behind the other, as one structure in 50 digits.

Unknowns are the displacement and rotation of the hub, the angles of the hinges and, of each node, what
its beam bends. The mass matrices are those of cubic elements that move with the whole structure: the
transverse velocity of a node is that of the foot of its beam, the rate of the beam times the distance,
and its own. Written for these tests from the theory of Euler and Bernoulli, with nothing of the package.
"""

import mpmath as mp
import numpy as np

import mbdlft
from mbdlft import Beam, Constant, Inertia, Scene
from tests import kit

DIGITS = 50
HUB_MASS, HUB_INERTIA, TIP_MASS, TIP_INERTIA = "40", "5", "2", "0.04"
MODULUS, DENSITY, AREA, SECOND_MOMENT, LENGTH = "70e9", "2700", "4e-4", "5e-8", "1"
STIFFNESS, DAMPING, STIFFNESS_DAMPING, ANGLE = "40", "0.1", "1e-4", "0.3"


def scene(beams: int, elements: int) -> Scene:
    """The structure as a scene; inputs are a torque on the hub and those of the hinges."""
    hub = Inertia(xx=3, yy=4, zz=float(HUB_INERTIA))
    tip = Inertia(xx=0.02, yy=0.03, zz=float(TIP_INERTIA))
    hinges = [
        kit.hinge(
            f"hinge{k}",
            f"beam{k - 1}.tip" if k else "hub",
            f"beam{k}",
            (0, 0, 1),
            position=float(ANGLE) if k else 0.0,
            stiffness=float(STIFFNESS),
            damping=float(DAMPING),
        )
        for k in range(beams)
    ]
    return kit.scene(
        "chain of beams",
        kit.body("hub", float(HUB_MASS), inertia=hub),
        kit.body("tip", float(TIP_MASS), inertia=tip),
        *(
            Beam(
                name=f"beam{k}",
                length="L",
                density=float(DENSITY),
                area=float(AREA),
                modulus=float(MODULUS),
                I_z=float(SECOND_MOMENT),
                elements=elements,
                stiffness_damping=float(STIFFNESS_DAMPING),
                deformations=["bending_y"],
            )
            for k in range(beams)
        ),
        kit.planar("base", "ground", "hub", (0, 0, 1), preload=(0, 0, 0)),
        *hinges,
        kit.weld("end", f"beam{beams - 1}.tip", "tip"),
        kit.torque("T", "hub", (0, 0, 1), magnitude=0),
        mbdlft.Acceleration(name="a", port="tip"),
        constants={"L": Constant(value=float(LENGTH), unit="m")},
        inputs=["T.torque", *(f"hinge{k}.torque" for k in range(beams))],
        outputs=["a.x", "a.y"],
    )


class _Structure:
    """Mass, damping and stiffness matrices, (n, n) each, that grow with what is added."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.M, self.C, self.K = (mp.matrix(n, n) for _ in range(3))

    def row(self, *unknowns: int) -> mp.matrix:
        found = mp.matrix(1, self.n)
        for k in unknowns:
            found[k] = 1
        return found

    def quadratic(self, rows: list[mp.matrix], matrix: mp.matrix) -> mp.matrix:
        stacked = mp.matrix([[row[k] for k in range(self.n)] for row in rows])
        return stacked.T * matrix * stacked


def accelerations(beams: int, elements: int, omega: list[float]) -> np.ndarray:
    """Accelerations (frequencies, 2, 1 + beams) of the tip, in m/s^2 per N m, at omega (rad/s)."""
    with mp.workdps(DIGITS):
        return _accelerations(beams, elements, omega)


def _accelerations(beams: int, elements: int, omega: list[float]) -> np.ndarray:
    each = 2 * elements
    s = _Structure(3 + beams * (1 + each))
    x, y, rotation = s.row(0), s.row(1), s.row(2)
    hub = mp.diag([mp.mpf(HUB_MASS), mp.mpf(HUB_MASS), mp.mpf(HUB_INERTIA)])
    s.M += s.quadratic([x, y, rotation], hub)
    forces, angle, length = [rotation], mp.mpf(0), mp.mpf(LENGTH)
    l = length / elements  # noqa: E741
    line = mp.mpf(DENSITY) * mp.mpf(AREA)  # kg/m
    mass, stiffness = _element(l, line, mp.mpf(MODULUS) * mp.mpf(SECOND_MOMENT))
    for k in range(beams):
        first = 3 + beams + k * each
        hinge = s.row(3 + k)
        s.K[3 + k, 3 + k] += mp.mpf(STIFFNESS)
        s.C[3 + k, 3 + k] += mp.mpf(DAMPING)
        forces.append(hinge)
        angle, rotation = angle + (mp.mpf(ANGLE) if k else 0), rotation + hinge
        c, n = mp.cos(angle), mp.sin(angle)
        along, across = c * x + n * y, c * y - n * x
        s.M += s.quadratic([along], mp.matrix([[line * length]]))
        bent = [(s.row(), s.row())]
        bent += [(s.row(first + 2 * i), s.row(first + 2 * i + 1)) for i in range(elements)]
        moved = [(across + i * l * rotation + w, rotation + t) for i, (w, t) in enumerate(bent)]
        for i in range(elements):
            s.M += s.quadratic([*moved[i], *moved[i + 1]], mass)
            added = s.quadratic([*bent[i], *bent[i + 1]], stiffness)
            s.K += added
            s.C += mp.mpf(STIFFNESS_DAMPING) * added
        across, rotation = moved[-1]
        x, y = c * along - n * across, n * along + c * across
    tip = mp.diag([mp.mpf(TIP_MASS), mp.mpf(TIP_MASS), mp.mpf(TIP_INERTIA)])
    s.M += s.quadratic([x, y, rotation], tip)
    found = np.zeros((len(omega), 2, len(forces)), dtype=complex)
    for i, w in enumerate(omega):
        factors, order = mp.mp.LU_decomp(mp.mpc(0, w) ** 2 * s.M + mp.mpc(0, w) * s.C + s.K)
        for j, force in enumerate(forces):
            q = mp.mp.U_solve(factors, mp.mp.L_solve(factors, force.T, order))
            found[i, :, j] = [complex(-(mp.mpf(w) ** 2) * (one * q)[0]) for one in (x, y)]
    return found


def _element(length: mp.mpf, line: mp.mpf, bending: mp.mpf) -> tuple[mp.matrix, mp.matrix]:
    """Mass and stiffness (4, 4) of a cubic element: displacement and rotation of its two ends."""
    l = length  # noqa: E741
    mass = [
        [156, 22 * l, 54, -13 * l],
        [22 * l, 4 * l**2, 13 * l, -3 * l**2],
        [54, 13 * l, 156, -22 * l],
        [-13 * l, -3 * l**2, -22 * l, 4 * l**2],
    ]
    stiffness = [
        [12, 6 * l, -12, 6 * l],
        [6 * l, 4 * l**2, -6 * l, 2 * l**2],
        [-12, -6 * l, 12, -6 * l],
        [6 * l, 2 * l**2, -6 * l, 4 * l**2],
    ]
    return line * l / 420 * mp.matrix(mass), bending / l**3 * mp.matrix(stiffness)


def response_in_many_digits(model: mbdlft.LFTModel, omega: list[float]) -> np.ndarray:
    """Nominal frequency response (frequencies, outputs, inputs) without rounding beyond the matrices'.

    Accelerations at low frequencies are differences of D and C (s I - A)^-1 B.
    """
    with mp.workdps(DIGITS):
        A, B, C, D = (mp.matrix(m.tolist()) for m in mbdlft.matrices_at(model, {}))
        found = np.zeros((len(omega), D.rows, D.cols), dtype=complex)
        for i, w in enumerate(omega):
            factors, order = mp.mp.LU_decomp(mp.mpc(0, w) * mp.eye(A.rows) - A)
            for j in range(B.cols):
                state = mp.mp.U_solve(factors, mp.mp.L_solve(factors, B[:, j], order))
                column = C * state + D[:, j]
                found[i, :, j] = [complex(entry) for entry in column]
        return found
