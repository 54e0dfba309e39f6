"""Indeterminate structures of steel under weight, thrust and spin, against finite elements of their own.

Columns between walls, portals and rings. Cubic and linear elements with consistent loads are exact
at their nodes for any load along them, so one element for each beam gives the exact trim of any mesh:
Przemieniecki, Theory of matrix structural analysis, 1968, chapters 5 and 6.
"""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import mbdlft
from mbdlft import Beam, Fixed, Ground, Loop, Parameter, Rotation, Scene

Array = NDArray[np.float64]
MOST = 1e-7  # of the largest load or deflection of its kind
MOST_OF_BOUND = (1.2, 2.0)  # times the proved bound of the order: with two parameters, and with more
SECONDS = 10.0  # of the processor
Z = (0.0, 0.0, 1.0)
STEEL = {"E": 210e9, "rho": 7800.0, "A": 1e-2, "I": 2e-6}
UNITS = {"h": "m", "E": "Pa", "rho": "kg/m^3", "A": "m^2", "I": "m^4"}


class Bar(NamedTuple):
    """A beam between two nodes; its length is `share` (m) plus `times` h."""

    start: int
    end: int
    angle: float  # deg, from x
    share: float
    times: float

    @property
    def text(self) -> float | str:
        """The length for a scene."""
        return self.share if not self.times else f"{self.times!r}*h" if not self.share else "h"


class Structure(NamedTuple):
    """Bars in a chain from a clamped node to a node that a loop holds, and its loads."""

    bars: tuple[Bar, ...]
    held: str  # kind of the loop
    elements: int
    gravity: tuple[float, float]  # (m/s^2)
    thrust: tuple[float, float]
    spin: float  # rad/s
    values: dict[str, float]  # at nominal
    names: tuple[str, ...]  # of the parameters


def structure(seed: int) -> Structure:
    """A column, a portal or a ring, and what it is made of and what acts on it."""
    random = np.random.default_rng(seed)
    h, span = random.uniform(2.0, 4.0), random.uniform(3.0, 6.0)
    turn = float(random.choice([0.0, 30.0, 90.0]))
    kind = seed % 3
    corners = 4
    bars = {
        0: (Bar(0, 1, turn, 0.0, 1.0),),
        1: (Bar(0, 1, 90.0, 0.0, 1.0), Bar(1, 2, 0.0, float(span), 0.0), Bar(2, 3, -90.0, 0.0, 1.0)),
        2: tuple(Bar(k, (k + 1) % corners, turn + 360.0 * k / corners, 0.0, 1.0) for k in range(corners)),
    }[kind]
    count = 1 + (seed + 1) // 2 % 4
    names = ["h", "E", *map(str, random.permutation(["rho", "A", "I"]))][:count]
    load = seed % 4
    return Structure(
        bars=bars,
        held="revolute" if kind == 1 and random.random() < 0.5 else "fixed",
        elements=seed // 3 % 2 + (2 if kind == 0 else 1),
        gravity=(0.0, -9.81) if load in (0, 2) else (0.0, 0.0),
        thrust=(float(random.uniform(5.0, 30.0)), 3.0) if load in (1, 2) else (0.0, 0.0),
        spin=float(random.uniform(0.5, 3.0)) if load == 3 else 0.0,
        values={"h": float(h), **{k: v * float(random.uniform(0.5, 2.0)) for k, v in STEEL.items()}},
        names=tuple(sorted(names)),
    )


def scene_of(s: Structure) -> Scene:
    """The scene of a structure."""
    own = {
        "density": "rho", "area": "A", "modulus": "E", "I_z": "I", "elements": s.elements,
        "deformations": ("axial", "bending_y"),
    }  # fmt: skip
    bodies = [Beam(name=f"b{k}", length=bar.text, **own) for k, bar in enumerate(s.bars)]
    joints, before = [], 0.0
    for k, bar in enumerate(s.bars):
        parent = f"b{k - 1}.tip" if k else "ground"
        turned = (Rotation(axis=Z, angle=f"{bar.angle - before!r}*deg"),)
        joints.append(Fixed(name=f"f{k}", parent=parent, child=f"b{k}", orientation=turned))
        before = bar.angle
    end = [0.0, 0.0]
    for bar in s.bars:
        for i, f in enumerate((np.cos, np.sin)):
            end[i] += bar.times * float(f(np.deg2rad(bar.angle)))
    span = sum(bar.share for bar in s.bars)
    x = f"{end[0]!r}*h" if not span and abs(end[0]) > 1e-9 else span
    y = f"{end[1]!r}*h" if abs(end[1]) > 1e-9 else 0.0
    axis = {"axis": Z} if s.held == "revolute" else {}
    if s.held == "fixed":
        axis = {"orientation": (Rotation(axis=Z, angle=f"{before!r}*deg"),)}
    loads = {
        "gravity": (*s.gravity, 0.0), "acceleration": (*s.thrust, 0.0),
        "spin": mbdlft.Spin(rate=s.spin, axis=Z) if s.spin else None,
    }  # fmt: skip
    return Scene(
        name="structure",
        parameters=[Parameter(n, s.values[n], percent=20, unit=UNITS[n]) for n in s.names],
        constants={n: value for n, value in s.values.items() if n not in s.names},
        bodies=[Ground(ports={"wall": (x, y, 0.0)}), *bodies],
        joints=joints,
        loops=[
            Loop(name="held", kind=s.held, parent="ground.wall", child=f"{bodies[-1].name}.tip", **axis)
        ],
        inputs=["ground.acceleration.x"],
        outputs=["b0.axial.1.displacement"],
        **loads,
    )


def exact_trim(s: Structure, values: dict[str, float]) -> dict[str, float]:
    """Loads at the loop, and deflections of the tips of the bars, by one element for each of them."""
    E, rho, A, second, h = (values[key] for key in ("E", "rho", "A", "I", "h"))
    nodes = 1 + max(max(bar.start, bar.end) for bar in s.bars)
    at = np.zeros((nodes, 2))
    K, f = np.zeros((3 * nodes, 3 * nodes)), np.zeros(3 * nodes)
    elements = []
    for bar in s.bars:
        length, angle = bar.share + bar.times * h, np.deg2rad(bar.angle)
        along = np.array([np.cos(angle), np.sin(angle)])
        if bar.end:
            at[bar.end] = at[bar.start] + length * along
        turn = np.kron(np.eye(2), [[*along, 0.0], [-along[1], along[0], 0.0], [0.0, 0.0, 1.0]])
        stiffness, pull = _stiffness(E * A, E * second, length), np.zeros(6)
        for x, weight in zip(*np.polynomial.legendre.leggauss(6), strict=True):
            t = 0.5 * (1.0 + x)
            place = at[bar.start] + t * length * along
            field = np.array(s.gravity) - np.array(s.thrust) + s.spin**2 * place
            local = turn[:2, :2] @ field * rho * A * 0.5 * weight * length
            pull += _shapes(t, length).T @ local
        rows = [*range(3 * bar.start, 3 * bar.start + 3), *range(3 * bar.end, 3 * bar.end + 3)]
        K[np.ix_(rows, rows)] += turn.T @ stiffness @ turn
        f[rows] += turn.T @ pull
        elements.append((rows, turn, stiffness, pull, length))
    last = s.bars[-1].end
    clamped = [0, 1, 2, 3 * last, 3 * last + 1, *([3 * last + 2] if s.held == "fixed" else [])]
    free = [k for k in range(3 * nodes) if k not in clamped]
    u = np.zeros(3 * nodes)
    u[free] = np.linalg.solve(K[np.ix_(free, free)], f[free]) if free else []
    expected = {}
    for k, (rows, turn, stiffness, pull, length) in enumerate(elements):
        local = turn @ u[rows]
        expected[f"b{k}.axial"] = local[3] - local[0]
        expected[f"b{k}.bending_y"] = local[4] - local[1] - length * local[2]
        end = stiffness @ local - pull
    expected["force"] = float(np.hypot(end[3], end[4]))
    if s.held == "fixed":
        expected["torque"] = float(abs(end[5]))
    return expected


def _stiffness(axial: float, bending: float, a: float) -> Array:
    """u, v, turn at both ends."""
    K = np.zeros((6, 6))
    K[np.ix_((0, 3), (0, 3))] = axial / a * np.array([[1.0, -1.0], [-1.0, 1.0]])
    K[np.ix_((1, 2, 4, 5), (1, 2, 4, 5))] = (bending / a**3) * np.array(
        [
            [12, 6 * a, -12, 6 * a],
            [6 * a, 4 * a**2, -6 * a, 2 * a**2],
            [-12, -6 * a, 12, -6 * a],
            [6 * a, 2 * a**2, -6 * a, 4 * a**2],
        ]
    )
    return K


def _shapes(t: float, a: float) -> Array:
    """Displacements (2,) along and across by the coordinates (6,) of an element."""
    across = (1 - 3 * t**2 + 2 * t**3, a * (t - 2 * t**2 + t**3), 3 * t**2 - 2 * t**3, a * (t**3 - t**2))
    return np.array([[1 - t, 0, 0, t, 0, 0], [0, across[0], across[1], 0, across[2], across[3]]])


def trim_of(s: Structure, model: mbdlft.LFTModel, values: dict[str, float]) -> dict[str, float]:
    """The same of a model."""
    chosen = {name: values[name] for name in s.names}
    trims = dict(
        zip([x.name for x in model.trim.signals], np.ravel(mbdlft.trim_at(model, chosen)), strict=True)
    )
    found = {}
    for k in range(len(s.bars)):
        for name, last in (("axial", s.elements), ("bending_y", 2 * s.elements - 1)):
            found[f"b{k}.{name}"] = float(trims[f"b{k}.{name}.{last}.displacement.static"])
    found["force"] = float(np.hypot(trims["held.force.x"], trims["held.force.y"]))
    if s.held == "fixed":
        found["torque"] = float(abs(trims["held.torque.3"]))
    return found


def attack(seed: int, folder: Path) -> str:
    """One structure at two places of its range."""
    s, random = structure(seed), np.random.default_rng(seed)
    begun = time.process_time()
    model = mbdlft.to_lft(scene_of(s), search=0.0, prove=0.0)
    spent = time.process_time() - begun
    for _ in range(2):
        values = {**s.values, **{name: s.values[name] * random.uniform(0.8, 1.2) for name in s.names}}
        expected, found = exact_trim(s, values), trim_of(s, model, values)
        for kinds in (("force", "torque"), ("axial", "bending_y")):
            names = [name for name in expected if name.endswith(kinds)]
            scale = max(abs(expected[name]) for name in names)
            for name in names:
                assert abs(found[name] - expected[name]) <= MOST * scale, (s, name, found, expected)
    bound = sum(model.certificate.lower_bound)
    most = MOST_OF_BOUND[len(s.names) > 2] * bound
    assert model.order <= most, (s, model.order, bound)
    assert spent <= SECONDS, spent
    return "right"
