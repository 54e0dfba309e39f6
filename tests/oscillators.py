"""Systems of closed form: oscillators, two masses, random ones; as systems of the package."""

from collections.abc import Sequence

import numpy as np

import mbdlft
from mbdlft import LFTModel, Parameter, System, state_space
from tests import kit


def plain(A: object, B: object, C: object, D: object = None, name: str = "plain") -> System:
    """A system without parameters, its inputs u0, u1, its outputs y0, y1, its states x0, x1."""
    B, C = np.array(B, dtype=float, ndmin=2), np.array(C, dtype=float, ndmin=2)
    D = np.zeros((len(C), B.shape[1])) if D is None else np.array(D, dtype=float, ndmin=2)
    return state_space(
        np.array(A, dtype=float, ndmin=2), B, C, D, name=name,
        inputs=[f"u{k}" for k in range(B.shape[1])], outputs=[f"y{k}" for k in range(len(C))],
    )  # fmt: skip


def oscillator(damping: float, omega: float = 1.0) -> System:
    """1/(s^2 + 2 damping omega s + omega^2)."""
    A = [[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]]
    return plain(A, [[0.0], [1.0]], [[1.0, 0.0]], name="oscillator")


def spring_and_mass(c: str = "0.02") -> LFTModel:
    """m q'' + c q' + k q = force with k and m in ranges."""
    own = [Parameter("k", 4.0, 3.0, 6.0, unit="N/m"), Parameter("m", 1.0, 0.8, 1.5, unit="kg")]
    rows = f"0 1 0; -k/m -({c})/m 1/m; 1 0 0"
    return kit.plant(rows, own, 2, "force", "position", name="spring", search=0.0)


def two_masses(m: Sequence[float], k: float, c: float, outputs: Sequence[int] = (0, 1)) -> System:
    """Free masses m with a spring k and a damper c between them; a force on the first one."""
    stiff = np.array([[-k, k], [k, -k]]) / np.array(m)[:, None]
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [stiff, stiff * c / k]])
    return plain(A, [[0.0], [0.0], [1.0 / m[0]], [0.0]], np.eye(4)[list(outputs)])


def free_chain(random: np.random.Generator) -> tuple[LFTModel, System]:
    """Masses in a row, free, springs and dampers between; a force in one spring moves the place of one.

    The second system has the stretches alone, by equations of its own, and the place from the center of
    mass, which stays: positions p(j) = p(0) + e(0) + ... + e(j-1), where p(0) is minus the mean of these.
    """
    n, decades = int(random.integers(5, 14)), float(random.uniform(5.0, 8.0))
    m, k = 10.0 ** random.uniform(-1.0, 1.0, n), 10.0 ** random.uniform(1.0, 1.0 + decades, n - 1)
    c = k * 10.0 ** random.uniform(-4.0, -1.0) / np.sqrt(k / np.min(m))
    pushed, seen, axis = int(random.integers(n - 1)), int(random.integers(n)), (1, 0, 0)
    points = [kit.point(f"b{i}", float(m[i]) if i else "m") for i in range(n)]
    laws = [{"stiffness": float(k[i]), "damping": float(c[i])} for i in range(n - 1)]
    if random.random() < 0.5:  # from one to the next
        first = kit.rail("to_b0", "ground", "b0", axis, position=0.0)
        links = [
            kit.rail(f"s{i}", f"b{i}", f"b{i + 1}", axis, position=1.0, **law)
            for i, law in enumerate(laws)
        ]
        parts, sign, effort = [first, *links], 1.0, "force"
    else:
        rails = [kit.rail(f"to_b{i}", "ground", f"b{i}", axis, position=float(i)) for i in range(n)]
        links = [
            kit.spring(f"s{i}", f"b{i}", f"b{i + 1}", force_density=0.0, **law)
            for i, law in enumerate(laws)
        ]
        parts, sign, effort = [*rails, *links], -1.0, "force_density"
    scene = kit.scene(
        "chain",
        Parameter("m", float(m[0]), percent=20, unit="kg"),
        *points,
        *parts,
        *(
            mbdlft.Position(name="place", port=f"b{seen}"),
            mbdlft.Acceleration(name="felt", port=f"b{seen}"),
        ),
        inputs=[f"s{pushed}.{effort}"],
        outputs=["place.x", "felt.x"],
    )
    stretch = np.diff(np.eye(n), axis=0)
    W = stretch @ np.diag(1.0 / m) @ stretch.T
    from_first = np.tril(np.ones((n, n - 1)), -1)
    place = from_first[seen] - m @ from_first / np.sum(m)
    A = np.block([[np.zeros((n - 1, n - 1)), np.eye(n - 1)], [-W * k, -W * c]])
    B = sign * np.concatenate([np.zeros(n - 1), W[:, pushed]])
    C = np.stack([np.append(place, np.zeros(n - 1)), place @ A[n - 1 :]])
    D = [[0.0], [place @ B[n - 1 :]]]
    return mbdlft.to_lft(scene, search=0.0, prove=0.0), plain(A, B[:, None], C, D)


def random_system(seed: int, n: int, ny: int, nu: int, *, direct: bool = False) -> System:
    """A stable random system."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.max(np.linalg.eigvals(A).real) + rng.uniform(0.05, 0.5)) * np.eye(n)
    D = rng.normal(size=(ny, nu)) if direct else np.zeros((ny, nu))
    return plain(A, rng.normal(size=(n, nu)), rng.normal(size=(ny, n)), D)


def matrices(system: System) -> tuple[np.ndarray, ...]:
    """A, B, C, D at nominal."""
    return system.A, system.B_u, system.C_y, system.D_yu
