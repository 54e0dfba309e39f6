"""The scenes of docs/trials.md against linear equations that were derived by hand, at random values.

Each derivation is a kinetic and a potential energy of second order in small coordinates, with the angles
measured as in the scene; nothing of this package is used for it.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from tests.close import CLOSED_FORM, target

FOLDER = Path(__file__).parents[2] / "docs" / "trials"
_G = 9.81
Values = dict[str, float]
ByHand = tuple[list[str], np.ndarray, np.ndarray, np.ndarray, list[str], np.ndarray]


def furuta(p: Values) -> ByHand:
    """The arm moves the hinge by r theta; the top of the pendulum falls the other way for alpha > 0."""
    m, length, r = p["m"], p["l"], 0.2
    swing = 4.0 / 3.0 * m * length**2
    mass = np.array([[0.001 + 0.2 * 0.01 + m * r * r, -m * r * length], [-m * r * length, swing]])
    stiffness = np.diag([0.0, -m * _G * length])
    return (["motor.angle", "hinge.angle"], mass, stiffness, 0 * mass, ["motor.torque"], np.eye(2)[:, :1])


def tower_crane(p: Values) -> ByHand:
    """Load at y = R theta + L a and x = position - L b."""
    m, length, radius = p["m"], p["L"], p["R"]
    across = np.array([radius, 0.0, length, 0.0])
    along = np.array([0.0, 1.0, 0.0, -length])
    mass = np.diag([2e6 + 400 * radius**2, 400.0, 0.0, 0.0])
    mass += m * (np.outer(across, across) + np.outer(along, along))
    stiffness = np.diag([0.0, 0.0, m * _G * length, m * _G * length])
    names = ["slew.angle", "travel.position", "sway.angle.1", "sway.angle.2"]
    return names, mass, stiffness, 0 * mass, ["slew.torque", "travel.force"], np.eye(4)[:, :2]


def half_car(p: Values) -> ByHand:
    """Heave, pitch (nose down for a positive angle about y), and both wheels."""
    front = np.array([1.0, -p["a"], -1.0, 0.0])
    rear = np.array([1.0, 1.5, 0.0, -1.0])
    mass = np.diag([p["M"], 1200.0, 40.0, 45.0])
    both = np.outer(front, front), np.outer(rear, rear)
    stiffness = p["ks"] * (both[0] + both[1]) + np.diag([0.0, 0.0, 18e4, 18e4])
    damping = 1500.0 * both[0] + 1600.0 * both[1]
    names = ["ride.position", "pitch.angle", "front_tire.position", "rear_tire.position"]
    return (names, mass, stiffness, damping, ["front_tire.force", "rear_tire.force"], np.eye(4)[:, 2:])


def quadrotor(p: Values) -> ByHand:
    """Load at x - L (b + pitch) and y + L (a + roll); the thrust turns with the body."""
    m, length, body, e = p["m"], p["L"], 1.2, np.eye(8)
    roll, pitch = e[3] + e[6], e[4] + e[7]
    mass = np.diag([body, body, body, 0.012, 0.013, 0.02, 0.0, 0.0])
    for moves in (e[0] - length * pitch, e[1] + length * roll, e[2]):
        mass += m * np.outer(moves, moves)
    stiffness = m * _G * length * (np.outer(roll, roll) + np.outer(pitch, pitch))
    thrust = (body + m) * _G
    stiffness[0, 4] -= thrust
    stiffness[1, 3] += thrust
    forces = np.zeros((8, 4))
    for k, (x, y) in enumerate([(0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25)]):
        forces[2:5, k] = 1.0, y, -x
    names = [f"flight.{what}.{axis}" for what in ("position", "rotation") for axis in "xyz"]
    inputs = [f"{name}.force" for name in ("front", "back", "left", "right")]
    return [*names, "hook.angle.1", "hook.angle.2"], mass, stiffness, 0 * mass, inputs, forces


def satellite(p: Values) -> ByHand:
    """Rotations of all about the center of mass, and of each wheel; the hub shifts with the center."""
    single = 300.0, 5.0, 0.3
    total = single[0] + 3 * single[1]
    center = single[1] * single[2] / total * np.ones(3)
    inertia = np.diag([100.0, 110.0, p["Jz"]])
    for k in range(3):
        place = single[2] * np.eye(3)[k]
        own = np.diag([0.1 if j == k else 0.06 for j in range(3)])
        inertia += own + single[1] * (place @ place * np.eye(3) - np.outer(place, place))
    inertia -= total * (center @ center * np.eye(3) - np.outer(center, center))
    wheels = 0.1 * np.eye(3)
    mass = np.block([[inertia, wheels], [wheels, wheels]])
    names = [f"orbit.rotation.{axis}" for axis in "xyz"] + [f"spin_{axis}.angle" for axis in "xyz"]
    torques = np.vstack([np.zeros((3, 3)), np.eye(3)])
    return names, mass, 0 * mass, 0 * mass, [f"spin_{axis}.torque" for axis in "xyz"], torques


FIRST = (furuta, tower_crane, half_car, quadrotor, satellite)


@pytest.mark.parametrize("by_hand", FIRST)
def test_scenes_of_the_trials_are_right(by_hand: Callable[[Values], ByHand]) -> None:
    model = mbdlft.to_lft(mbdlft.load_scene(FOLDER / f"{by_hand.__name__}.toml"), search=0.0)
    samples = mbdlft.random(model.parameters, 20, seed=5)
    found = mbdlft.matrices_at(model, samples)
    states, inputs = [s.name for s in model.states], [s.name for s in model.inputs]
    half = len(states) // 2
    for k in range(20):
        values = {name: float(column[k]) for name, column in samples.items()}
        names, mass, stiffness, damping, efforts, forces = by_hand(values)
        place = [states.index(name) for name in names]
        rates = [half + number for number in place]
        columns = [inputs.index(name) for name in efforts]
        for part, expected in (
            (found.A[k][np.ix_(rates, place)], -stiffness),
            (found.A[k][np.ix_(rates, rates)], -damping),
            (found.B[k][np.ix_(rates, columns)], forces),
        ):
            target(part, np.linalg.solve(mass, expected), CLOSED_FORM)
