"""Four systems, each as a scene, and once more written down by hand for numbers of any type."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import mbdlft
from benchmarks import scaling, ur5
from benchmarks.speed.motion import Circle, Link, Mass, Motion, add, chain_motion, times
from scenarios.ur5 import urdf

SCENARIOS = Path(__file__).parents[2] / "scenarios"
Values = Mapping[str, Any]


@dataclass(frozen=True)
class System:
    """A scene, and its motion by hand from values of its parameters (angles in rad).

    `links` is that of a chain of rigid links. The states of both are in the same order.
    """

    name: str
    scene: mbdlft.Scene
    motion: Callable[[Values, Circle], Motion]
    links: Callable[[Values], list[Link]] | None = None

    @property
    def parameters(self) -> tuple[mbdlft.Parameter, ...]:
        """In the order of the scene."""
        return tuple(self.scene.parameters)

    def samples(self, count: int, seed: int = 0) -> dict[str, np.ndarray]:
        """Random physical values in the units of the parameters."""
        return mbdlft.random(self.parameters, count, seed=seed)

    def in_radians(self, values: Values, degree: Any) -> dict[str, Any]:
        """The values with angles in rad; `degree` is one degree."""
        units = {p.name: p.unit for p in self.parameters}
        return {name: value * degree if units[name] == "deg" else value for name, value in values.items()}


def chain(name: str, scene: mbdlft.Scene, links: Callable[[Values], list[Link]]) -> System:
    """A system of links."""
    return System(name, scene, lambda p, circle: chain_motion(links(p), circle), links)


def arm_links(p: Values) -> list[Link]:
    """The arm; moments that it does not feel are made such that a body can have them."""
    J, L = p["J1"], p["L2"]
    first = Mass(p["m1"], (0, times(p["rho1"], 1), 0), (J, J, J))
    second = (Mass(2.0, (0, 0.5 * L, 0), (0.1, 0.1, 0.1)), Mass(p["m3"], (0, L, 0)))
    own = {"stiffness": 0.1, "damping": 0.1}
    return [
        Link((0, 0, 0), "x", p["theta1"], (first,), **own),
        Link((0, 1, 0), "x", p["theta2"], second, **own),
    ]


def chain_links(p: Values) -> list[Link]:
    """Four links, axes x and z in turn; three masses or lengths and two angles vary."""
    masses = (p["m0"], 2.0, 2.0, p["m3"])
    lengths = (1.0, 1.0, p["L2"], 1.0)
    angles = (p["t0"], 30.0 * np.pi / 180.0, p["t2"], 50.0 * np.pi / 180.0)
    found, offset = [], (0, 0, 0)
    for k, (mass, length, angle) in enumerate(zip(masses, lengths, angles, strict=True)):
        body = Mass(mass, (0, 0.5 * length, 0), (0.1, 0.05, 0.1))
        found.append(Link(offset, "z" if k % 2 else "x", angle, (body,)))
        offset = (0, length, 0)
    return found


def ur5_links(p: Values) -> list[Link]:
    """The numbers of the URDF file; its root, which does not move, is left out."""
    thin, wide = (0.111172755531, 0.111172755531, 0.21942), (0.0171364731454, 0.0171364731454)
    rows = (
        ((0, 0, 0.089159), "z", False, 3.7, 0, (0.010267495893, 0.010267495893, 0.00666)),
        ((0, 0.13585, 0), "y", True, 8.393, 0.28, (0.22689067591, 0.22689067591, 0.0151074)),
        ((0, -0.1197, 0.425), "y", False, 2.275, 0.25, (0.049443313556, 0.049443313556, 0.004095)),
        ((0, 0, 0.39225), "y", True, 1.219, 0, thin),
        ((0, 0.093, 0), "z", False, 1.219, 0, thin),
        ((0, 0, 0.09465), "y", False, 0.1879, 0, (*wide, 0.033822)),
    )
    found = []
    for k, (offset, axis, quarter, mass, center, inertia) in enumerate(rows, start=1):
        bodies = [Mass(mass, (0, 0, center), inertia)]
        if k == len(rows):
            bodies.append(Mass(p["payload"], (0, 0.0823, 0)))
        found.append(Link(offset, axis, p[f"theta{k}"], tuple(bodies), quarter))
    return found


def spacecraft_motion(p: Values, circle: Circle) -> Motion:
    """Hub and four beams of three cubic elements; displacements and slopes times the element's length.

    A beam moves with the hub by its absolute displacements: w + (r + x) phi, slopes theta + phi.
    """
    r, tip, hub, density = 0.3048, 2.44046e-3, 10.84654, 1.3017
    bending = 75.84233e9 * (0.1524 * 3.175e-3**3 / 12.0)
    mass4 = ((156, 22, 54, -13), (22, 4, 13, -3), (54, 13, 156, -22), (-13, -3, -22, 4))
    stiff4 = ((12, 6, -12, 6), (6, 4, -6, 2), (-12, -6, 12, -6), (6, 2, -6, 4))
    n = 1 + 4 * 6
    M: list[list[Any]] = [[0] * n for _ in range(n)]
    K: list[list[Any]] = [[0] * n for _ in range(n)]
    M[0][0] = hub
    for beam in range(4):
        L, m = p[f"L{beam + 1}"], p[f"M{beam + 1}"]
        h = L / 3.0
        own = [[0] * 8 for _ in range(8)]
        bent = [[0] * 8 for _ in range(8)]
        for at in (0, 2, 4):
            for i in range(4):
                for j in range(4):
                    own[at + i][at + j] += mass4[i][j]
                    bent[at + i][at + j] += stiff4[i][j]
        line, spring, twist = density * h / 420.0, bending / (h * h * h), tip / (h * h)
        whole: list[list[Any]] = [[line * float(x) if x else 0 for x in row] for row in own]
        whole[6][6], whole[7][7] = add(whole[6][6], m), add(whole[7][7], twist)
        carried = [x for k in range(4) for x in (r + float(k) * h if k else r, h)]
        first = 1 + 6 * beam
        pulled = [add(*(times(x, y) for x, y in zip(row, carried, strict=True))) for row in whole]
        M[0][0] = add(M[0][0], *(times(x, y) for x, y in zip(pulled, carried, strict=True)))
        for i in range(2, 8):
            row = first + i - 2
            M[0][row] = M[row][0] = pulled[i]
            for j in range(2, 8):
                M[row][first + j - 2] = whole[i][j]
                if bent[i][j]:
                    K[row][first + j - 2] = spring * float(bent[i][j])
    outputs: list[list[Any]] = [[int(i == j) for j in range(3 * n)] for i in (0, n, 2 * n + 5)]
    outputs[2][2 * n] = r + p["L1"]
    return Motion(M, [0] * n, K, (0,), outputs)


def systems() -> tuple[System, ...]:
    """All four."""
    load = mbdlft.load_scene
    return (
        chain("two-link arm", load(SCENARIOS / "two_link_arm.toml"), arm_links),
        chain("spatial chain of 4", scaling.scene("spatial chain", 4, few=True), chain_links),
        chain("UR5", ur5.scene(urdf()), ur5_links),
        System("flexible satellite", load(SCENARIOS / "rotatory_spacecraft.toml"), spacecraft_motion),
    )
