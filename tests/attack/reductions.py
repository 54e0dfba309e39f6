"""Finite elements in a few modes: the rigid body, statics at the ports, and frequencies from above.

Structures are random frames of bars in space, in node axes of their own, with their own finite elements;
and beams of scenes, whose rigid body is the same whatever they deform in.
"""

from pathlib import Path

import numpy as np
import scipy.linalg

import mbdlft
from mbdlft.elastic import Nodes, modal_model
from mbdlft.elastic.partition import mass_matrix
from mbdlft.multibody.to_problem import problem_of_scene
from tests import kit
from tests.reference.frames import Section, element

RIGID, STATIC, ABOVE = 1e-10, 1e-7, 1e-7  # of the size of a direction; of a port's; of a frequency
DEFORMATIONS = ["axial", "torsion", "bending_y", "bending_z"]
SENSORS = mbdlft.Acceleration, mbdlft.AngularAcceleration
OMEGA = 3e-6  # rad/s; the slowest mode of these has 1
METHODS = ["hurty", "craig-bampton", "static-correction", "effective-mass"]


def bar(a: np.ndarray, b: np.ndarray, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """M and K (12, 12) in the axes of space of a bar from a to b: cubic shapes, sections on main axes."""
    length, area = float(np.linalg.norm(b - a)), 10.0 ** random.uniform(-4.0, -3.0)
    I_z, I_y = area**2 * random.uniform(0.1, 1.0, 2)
    M, K = element(Section(A=area, I_y=I_y, I_z=I_z, J=0.2 * area**2), length)
    x = (b - a) / length
    y = np.linalg.qr(np.column_stack([x, random.standard_normal(3)]))[0][:, 1]
    T = np.kron(np.eye(4), np.column_stack([x, y, np.cross(x, y)]))
    return T @ M @ T.T, T @ K @ T.T


def frame(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, Nodes, np.ndarray]:
    """M, K, nodes and R (N, 6), the rigid motions about the first node, of a tree of bars with loops."""
    n = int(random.integers(5, 12))
    at = random.uniform(-2.0, 2.0, (n, 3))
    bars = [(int(random.integers(k)), k) for k in range(1, n)]
    bars += [(i, j) for i, j in random.integers(n, size=(3, 2)).tolist() if i != j]
    M, K, R = (np.zeros((6 * n, size)) for size in (6 * n, 6 * n, 6))
    for i, j in bars:
        rows = np.r_[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
        for whole, part in zip((M, K), bar(at[i], at[j], random), strict=True):
            whole[np.ix_(rows, rows)] += part
    turns = np.array([np.linalg.qr(random.standard_normal((3, 3)))[0] for _ in range(n)])
    turns *= np.sign(np.linalg.det(turns))[:, None, None]
    for k, r in enumerate(at - at[0]):
        R[6 * k : 6 * k + 6] = np.eye(6)
        R[6 * k : 6 * k + 3, 3:] = -np.cross(np.eye(3), r)
    Q = scipy.linalg.block_diag(*(np.kron(np.eye(2), turn) for turn in turns))
    M, K = (Q.T @ (matrix + matrix.T) @ Q / 2.0 for matrix in (M, K))
    return (M + M.T) / 2.0, (K + K.T) / 2.0, Nodes(10 * np.arange(n) + 7, at, axes=turns), Q.T @ R


def beam_in_space(random: np.random.Generator) -> None:
    """Accelerations of its origin by loads there, far below its modes, in 50 digits."""
    length, area = float(random.uniform(0.3, 5.0)), float(10.0 ** random.uniform(-5.0, -2.0))
    I_y, I_z = (float(area**2 * 10.0 ** random.uniform(-1.5, 0.0)) for _ in "yz")
    kinds = [k for k in DEFORMATIONS if random.random() < 0.5] or [str(random.choice(DEFORMATIONS))]
    by_modes, has_shear, turns = (bool(x) for x in random.random(3) < (0.5, 0.3, 0.3))
    beam = mbdlft.Beam(
        name="beam", length=length, density=2700.0, area=area, modulus=7e10, shear_modulus=2.6e10,
        I_y=I_y, I_z=I_z, torsion_constant=0.2 * area**2, deformations=tuple(kinds),
        rotary_inertia=turns, shear_coefficient=0.85 if has_shear and not by_modes else None,
        **{"modes" if by_modes else "elements": int(random.integers(1, 7))},
    )  # fmt: skip
    unit = np.eye(3).tolist()
    loads = [
        kind(f"{name}{k}", "beam", tuple(unit[k]), frame="ground", magnitude=0.0)
        for name, kind in (("force", kit.force), ("torque", kit.torque))
        for k in range(3)
    ]
    scene = kit.scene(
        "space", mbdlft.Parameter("L", 1.0, percent=1), beam, kit.free("fly", "ground", "beam"), *loads,
        *(kind(name=kind.kind, port="beam") for kind in SENSORS),
        inputs=[f"{load.name}.{load.kind}" for load in loads],
        outputs=[f"{kind.kind}.{axis}" for kind in SENSORS for axis in "xyz"],
    )  # fmt: skip
    mass, is_thick = 2700.0 * area * length, beam.has_rotary_inertia
    across = [mass * length**2 / 3.0 + is_thick * 2700.0 * second * length for second in (I_y, I_z)]
    rigid = np.diag([mass, mass, mass, 2700.0 * (I_y + I_z) * length, *across])
    rigid[1, 5] = rigid[5, 1] = mass * length / 2.0
    rigid[2, 4] = rigid[4, 2] = -mass * length / 2.0
    by_loads = problem_of_scene(scene).reference().transfers_in_digits([0], np.array([OMEGA]))[0, 0].real
    size = np.sqrt(np.outer(np.diag(rigid), np.diag(rigid)))
    assert np.all(np.abs(np.linalg.inv(by_loads) - rigid) <= RIGID * size), kinds


def attack(seed: int, folder: Path) -> str:
    """A beam; or a structure with one to three ports, by one method with a few modes, and with more."""
    random = np.random.default_rng(seed)
    if seed % 5 == 4:
        beam_in_space(random)
        return "right"
    M, K, nodes, R = frame(random)
    chosen = random.permutation(np.arange(1, len(nodes)))[: int(random.integers(1, 4))]
    ports = {f"p{k}": 10 * k + 7 for k in chosen.tolist()}
    method, free = METHODS[seed % 4], np.arange(6, len(M))
    most = len(free) - 6 * len(ports) if method in METHODS[:2] else len(free) // 2
    counts = sorted(random.integers(0 if method in METHODS[:2] else 1, most, 2).tolist())
    w = np.sqrt(scipy.linalg.eigh(K[6:, 6:], M[6:, 6:], eigvals_only=True))
    axes = scipy.linalg.block_diag(*(np.kron(np.eye(2), np.asarray(nodes.axes)[k]) for k in chosen))
    rows = np.concatenate([np.arange(6 * k, 6 * k + 6) for k in chosen]) - 6
    flexible = axes @ np.linalg.inv(K[6:, 6:])[np.ix_(rows, rows)] @ axes.T
    whole, found = R.T @ M @ R, []
    for count in counts:
        m = modal_model(M, K, nodes, 7, ports, method=method, modes=max(count, 1))
        size = np.sqrt(np.outer(np.diag(whole), np.diag(whole)))
        assert np.all(np.abs(mass_matrix(m.rigid) - whole) <= RIGID * size), (seed, "rigid")
        shapes = np.vstack([m.shapes[name] for name in ports])
        statics = shapes / m.frequencies**2 @ shapes.T
        size = np.sqrt(np.outer(np.diag(flexible), np.diag(flexible)))
        if method != "effective-mass":
            assert np.all(np.abs(statics - flexible) <= STATIC * size), (seed, "statics")
        assert np.all(m.frequencies >= w[: len(m.frequencies)] * (1.0 - ABOVE)), (seed, "below")
        found.append(m.frequencies)
    # static corrections that hardly add anything are left out: of their frequencies nothing is said
    few, more = (w[: counts[0] if method == "static-correction" else len(found[0])] for w in found)
    assert np.all(more <= few * (1.0 + ABOVE)), (seed, "no convergence")
    return "right"
