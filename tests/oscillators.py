"""Systems of closed form: oscillators, two masses, random ones; as systems of the package."""

from collections.abc import Sequence

import numpy as np

from mbdlft import LFTModel, Parameter, System, realize, state_space


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
    return realize(
        [["0", "1", "0"], ["-k/m", f"-({c})/m", "1/m"], ["1", "0", "0"]],
        [Parameter("k", 4.0, 3.0, 6.0, unit="N/m"), Parameter("m", 1.0, 0.8, 1.5, unit="kg")],
        states=2,
        inputs=["force"],
        outputs=["position"],
        name="spring",
        search=0.0,
    )


def two_masses(m: Sequence[float], k: float, c: float, outputs: Sequence[int] = (0, 1)) -> System:
    """Free masses m with a spring k and a damper c between them; a force on the first one."""
    stiff = np.array([[-k, k], [k, -k]]) / np.array(m)[:, None]
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [stiff, stiff * c / k]])
    return plain(A, [[0.0], [0.0], [1.0 / m[0]], [0.0]], np.eye(4)[list(outputs)])


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
