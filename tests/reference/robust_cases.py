"""Systems whose structured singular value or margin is known, and where from."""

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

import mbdlft
from mbdlft import Block, ComplexBlock, FullBlock, Parameter, Signal, System, realize
from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT, delta, inverse
from tests import kit


def unit(name: str) -> Parameter:
    """A parameter that is its own delta."""
    return Parameter(name, 0.0, low=-1.0, high=1.0)


def static(M: ArrayLike, *blocks: Block) -> System:
    """A matrix without states, closed through blocks sorted by name."""
    matrix = np.asarray(M)
    n, m = matrix.shape
    lft = LFT(matrix, np.zeros((n, 0)), np.zeros((0, m)), np.zeros((0, 0)), blocks)
    own = tuple(unit(block.name) for block in blocks if block.kind == "real")
    return System("matrix", lft, (), (), (), mbdlft.Parameters(own))


def of_matrices(A: Array, B: Array, C: Array, D: Array, *blocks: Block) -> System:
    """xdot = A x + B w, z = C x + D w, w = Delta z."""
    states = tuple(Signal(f"x{k}", "1") for k in range(len(A)))
    own = tuple(unit(block.name) for block in blocks if block.kind == "real")
    return System("loop", LFT(D, C, B, A, blocks), states, (), (), mbdlft.Parameters(own))


def ab13md() -> tuple[NDArray[np.complex128], tuple[Block, ...]]:
    """The example of the SLICOT documentation of AB13MD."""
    rows = [
        [-1 + 6j, 2 - 3j, 3 + 8j, 3 + 8j, -5 - 9j, -6 + 2j],
        [4 + 2j, -2 + 5j, -6 - 7j, -4 + 11j, 8 - 7j, 12 - 1j],
        [5 - 4j, -4 - 8j, 1 - 3j, -6 + 14j, 2 - 5j, 4 + 16j],
    ]
    blocks = (Block("a", 1), Block("b", 1), FullBlock("c", 2), ComplexBlock("d", 1), ComplexBlock("e", 1))
    return np.array(rows + rows), blocks


def two_carts() -> System:
    """Two carts and a spring, each 1 +-20 %, and 100((s + 1)/(0.001 s + 1))^3 (a known demo)."""
    own = [Parameter(name, 1.0, low=0.8, high=1.2) for name in ("k", "m1", "m2")]
    rows = "0 1 0 0 0; -k/m1 0 k/m1 0 1/m1; 0 0 0 1 0; k/m2 0 -k/m2 0 0; 0 0 1 0 0"
    plant = kit.plant(rows, own, 4, "force", "position")
    lead = control.tf([1.0, 1.0], [0.001, 1.0])
    return mbdlft.feedback(plant, 100.0 * lead * lead * lead)


def rotating() -> System:
    """A of two states, polynomial in three parameters; its margin is the root of k^3 + 5k = 2."""
    matrix = [["-1+5*a", "-10*(1+b)"], ["10*(1+c^2)", "-1-a*b*c"]]
    return realize(matrix, [unit(name) for name in "abc"], states=2, inputs=[], outputs=[])


def discrete_pair() -> System:
    """[0, 3/4 + d; 3/4 - d, 0] in discrete time, by the bilinear map in continuous time."""
    d = delta("d", 1)
    right, left = np.array([[1.0], [0.0]]), np.array([[0.0], [-1.0]])
    A = np.array([[0.0, 0.75], [0.75, 0.0]]) + right @ d @ np.array([[0.0, 1.0]])
    A = A + left @ d @ np.array([[1.0, 0.0]])
    mapped = (A + -np.eye(2)) @ inverse(A + np.eye(2))
    states = (Signal("x1", "1"), Signal("x2", "1"))
    return System("pair", mapped, states, (), (), mbdlft.Parameters((unit("d"),)))


_AIRCRAFT = (
    -0.082,
    0.010827,
    0.060268,
    0.002,
    0.0118,
    -0.84,
    -0.76,
    0.74,
    0.095,
    0.06,
    0.092,
    -0.23,
    -0.114,
    -0.151,
)


def _derivatives(values: Array) -> Array:
    """[A B; C D] of the lateral motion."""
    Yb, Yp, Yr, Ydp, Ydr, Lb, Lp, Lr, Ldp, Ldr, Nb, Np, Nr, Ndr = values
    g, angle = 0.146418, np.deg2rad(8.0)
    c = -np.pi / 180.0 / g
    return np.array(
        [
            [Yb, Yp + np.sin(angle), Yr - np.cos(angle), g, Ydp, Ydr],
            [Lb, Lp, Lr, 0, Ldp, Ldr],
            [Nb, Np, Nr, 0, 0, Ndr],
            [0, 1, 0.14, 0, 0, 0],
            [c * Yb, c * Yp, c * Yr, 0, c * Ydp, c * Ydr],
            [0, 1, 0, 0, 0, 0],
            [0, 0, 1, 0, 0, 0],
            [0, 0, 0, 1, 0, 0],
        ]
    )


def transport_aircraft() -> System:
    """Lateral motion of a transport aircraft, 14 derivatives +-10 %, with output feedback."""
    nominal = np.array(_AIRCRAFT)
    middle, lefts, rights = _derivatives(nominal), [], []
    for k in range(14):
        other = nominal.copy()
        other[k] *= 1.1
        u, s, v = np.linalg.svd(_derivatives(other) - middle)
        lefts.append(u[:, 0] * np.sqrt(s[0]))
        rights.append(v[0] * np.sqrt(s[0]))
    left, right = np.array(lefts).T, np.array(rights)
    blocks = tuple(Block(f"p{k:02d}", 1) for k in range(14))
    lft = LFT(np.zeros((14, 14)), right, left, middle, blocks)
    own = tuple(unit(block.name) for block in blocks)
    plant = System(
        "aircraft",
        lft,
        tuple(Signal(name, "1") for name in ("beta", "p", "r", "phi")),
        (Signal("aileron", "1"), Signal("rudder", "1")),
        tuple(Signal(f"y{k}", "1") for k in range(4)),
        mbdlft.Parameters(own),
    )
    actuators = mbdlft.append(
        mbdlft.as_system(
            control.tf([-1.77, 399.0], [1.0, 48.2, 399.0]), name="a1", inputs=["u1"], outputs=["aileron"]
        ),
        mbdlft.as_system(
            control.tf([2.6, -1185.0, 27350.0], [1.0, 77.7, 3331.0, 27350.0]),
            name="a2",
            inputs=["u2"],
            outputs=["rudder"],
        ),
    )
    gain = [[-629.8858, 11.5254, 3.3110, 9.4278], [285.9496, 0.3693, -2.6301, -0.5489]]
    return mbdlft.feedback(plant * actuators, np.array(gain))


def distillation(integrator: float = 1e-6) -> System:
    """Skogestad, Postlethwaite, p. 325: complex blocks 1, 1, and a full 2 x 2 block of performance.

    The integrator of the weight of performance is a slow pole: no loop stabilizes it.
    """
    G = np.array([[87.8, -86.4], [108.2, -109.6]])
    I = np.eye(2)  # noqa: E741
    plant = mbdlft.as_system(
        control.ss(-I / 75.0, I / 75.0, G, 0.0 * I), name="g", inputs=["u1", "u2"], outputs=["g1", "g2"]
    )
    inverse_gain = 0.7 * np.linalg.inv(G)
    controller = mbdlft.as_system(
        control.ss(0.0 * I, I, inverse_gain, 75.0 * inverse_gain),
        name="k",
        inputs=["e1", "e2"],
        outputs=["c1", "c2"],
    )
    # (s + 0.2)/(0.5 s + 1) and (0.5 s + 0.05)/(s + integrator), twice each
    weights = mbdlft.as_system(
        control.ss(-2.0 * I, I, -3.6 * I, 2.0 * I), name="i", inputs=["v1", "v2"], outputs=["a1", "a2"]
    )
    slope = 0.05 - 0.5 * integrator
    performance = mbdlft.as_system(
        control.ss(-integrator * I, I, slope * I, 0.5 * I),
        name="p",
        inputs=["y1", "y2"],
        outputs=["b1", "b2"],
    )
    wires = []
    for k in ("1", "2"):
        wires += [[f"u{k}", f"c{k}", f"w{k}"], [f"v{k}", f"c{k}"]]
        wires += [[f"e{k}", f"-g{k}", f"-d{k}"], [f"y{k}", f"g{k}", f"d{k}"]]
    net = mbdlft.connect(
        [plant, controller, weights, performance],
        wires,
        inputs=["w1", "w2", "d1", "d2"],
        outputs=["a1", "a2", "b1", "b2"],
    )
    blocks = (ComplexBlock("a", 1), ComplexBlock("b", 1), FullBlock("c", 2))
    return of_matrices(net.A, net.B_u, net.C_y, net.D_yu, *blocks)
