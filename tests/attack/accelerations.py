"""Accelerations of chains of beams far below the modes: s^2 times positions, if they are held at one end.

If they are free, a motor between two of them moves all as it does in 50 digits, and any force accelerates
all as it does there.
"""

from pathlib import Path

import numpy as np

import mbdlft
from mbdlft import Beam, Scene
from mbdlft.multibody.to_problem import problem_of_scene
from tests import kit

# of the largest of a row, or of the vector by an input: eps times the square of fastest over slowest
MOST = 1e-6
KINDS = ["axial", "torsion", "bending_y", "bending_z"]
OMEGA = 10.0 ** np.arange(-4.0, 3.0)  # rad/s


def scene_of(random: np.random.Generator, *, is_free: bool) -> Scene:
    """One or two beams with a body between them, a joint that may give way, and gravity in some."""
    kinds = {"bending_y", *random.choice(KINDS, size=int(random.integers(1, 5))).tolist()}
    falls = kinds <= {"axial", "bending_y"} and random.random() < 0.5
    beam = Beam(
        name="first", length="L", density=7800.0, area=1e-3, modulus=2.1e11, shear_modulus=8e10,
        I_y=1e-7, I_z=2e-7, torsion_constant=1e-7, elements=int(random.integers(1, 6)),
        deformations=tuple(k for k in KINDS if k in kinds), stiffness_damping=random.choice([0.0, 1e-5]),
    )  # fmt: skip
    held = {"stiffness": float(10.0 ** random.uniform(0.0, 5.0)), "damping": 0.01}
    link = [
        kit.weld("link", "body", "second"),
        kit.hinge("link", "body", "second", (0, 0, 1), position=0.0, **held),
    ][max(random.integers(2), is_free)]
    root = [kit.weld, kit.free][is_free]("root", "ground", "first")
    end = str(random.choice(["body", "second.tip"]))
    linear = mbdlft.Position, mbdlft.Acceleration, mbdlft.Accelerometer
    sensors = *linear, mbdlft.SmallRotation, mbdlft.AngularAcceleration
    return kit.scene(
        "held",
        mbdlft.Parameter("L", 1.5, percent=20, unit="m"),
        mbdlft.Parameter("m", 2.0, percent=20, unit="kg"),
        beam,
        kit.body("body", "m", (0.1, 0.1, 0.15), center_of_mass=(0.1, 0.0, 0.0)),
        beam.model_copy(update={"name": "second"}),
        *(root, kit.weld("top", "first.tip", "body"), link),
        *(kind(name=kind.kind, port=end) for kind in sensors),
        kit.force("push", end, (1, 2, 3), frame="ground", magnitude=0.0),
        kit.torque("turn", "body", (1, -1, 2), frame="ground", magnitude=0.0),
        gravity=(0.0, -9.81 * (falls and not is_free), 0.0),
    )


def attack(seed: int, folder: Path) -> str:
    """One scene at two places of its range; an accelerometer feels gravity in its turn."""
    random, is_free = np.random.default_rng(seed), seed % 3 == 2
    scene = scene_of(random, is_free=is_free)
    model = mbdlft.to_lft(scene, search=0.0, prove=0.0)
    if is_free:
        truth = problem_of_scene(scene).reference().transfers_in_digits([0], OMEGA)[0]
        found = mbdlft.frequency_response(model, {}, OMEGA)[0]
        units = np.array([signal.unit for signal in model.outputs])
        known = model.certificate
        for j, i in enumerate(known.momenta):  # places by forces from outside lose digits
            rows = np.full(len(units), i > 0) | (np.array(known.rigid_motions) > 0)
            for unit in {*units[rows].tolist()}:
                some = rows & (units == unit)
                errors, sizes = (np.abs(x[:, some, j]) for x in (found - truth, truth))
                right = errors <= MOST * np.max(sizes, axis=1, keepdims=True)
                assert np.all(right), (seed, model.order, unit, model.inputs[j].name)
        return "right"
    response = mbdlft.frequency_response(model, mbdlft.random(model.parameters, 2, seed), OMEGA)
    places = {signal.name: k for k, signal in enumerate(model.outputs)}
    of = {
        kind: response[:, :, [places[f"{kind}.{axis}"] for axis in "xyz"]]
        for kind in ("position", "rotation", "acceleration", "angular_acceleration", "accelerometer")
    }
    above, squares = -np.array(scene.gravity)[:, None], -(OMEGA[:, None, None] ** 2)
    for found, expected in (
        (of["acceleration"], squares * of["position"]),
        (of["angular_acceleration"], squares * of["rotation"]),
        (of["accelerometer"], squares * of["position"] - np.cross(of["rotation"], above, 2, 0, 2)),
    ):
        of_row, of_input = (np.max(np.abs(expected), axis=k, keepdims=True) for k in (3, 2))
        scale = np.maximum(of_row, of_input)
        assert np.all(np.abs(found - expected) <= MOST * scale), (seed, model.order)
    return "right"
