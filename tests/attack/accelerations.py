"""Accelerations of chains of beams far below the modes: s^2 times positions, if they are held at one end.

If they are free, a motor between two of them moves all as it does in 50 digits, and so does any force;
also bodies of which each has the ground for parent, with springs between.
"""

from pathlib import Path

import numpy as np

import mbdlft
from mbdlft import Beam, Scene
from mbdlft.multibody.to_problem import problem_of_scene
from tests import kit

# of the largest of a row, or of the vector by an input: eps times the square of fastest over slowest
MOST = 1e-6
STEP = 1e-6  # of the frequency: A (1 + e), a rounding of A, moves a response as the frequency 1/(1 + e)
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


def bodies_apart(random: np.random.Generator) -> Scene:
    """Three to six bodies in a plane, soft and stiff springs between neighbors, forces in and on them."""
    n, decades = int(random.integers(3, 7)), float(random.uniform(1.0, 6.0))
    names, sides = [f"b{i}" for i in range(n)], {"a": 0.3, "b": -0.3, "c": 0.1}
    ports = {f"{p}{k}": (0.5 * (2 * k - 1), y, 0) for p, y in sides.items() for k in (0, 1)}
    masses = ["m", *(float(m) for m in 10.0 ** random.uniform(-0.5, 0.5, n - 1))]
    ends = [("a1", "a0"), ("b1", "b0"), ("c1", "b0")]
    laws = 10.0 ** random.uniform(1.0, 1.0 + decades, (n, len(ends)))
    damping = 10.0 ** random.uniform(-5.0, -2.0)
    kinds = mbdlft.Position, mbdlft.Velocity, mbdlft.SmallRotation, mbdlft.AngularRate
    kinds = *kinds, mbdlft.Acceleration, mbdlft.AngularAcceleration
    pushed, seen = (str(random.choice(names)) for _ in range(2))
    return kit.scene(
        "apart",
        mbdlft.Parameter("m", 2.0, percent=20, unit="kg"),
        *(kit.body(b, m, (0.1, 0.1, 0.2), ports=ports) for b, m in zip(names, masses, strict=True)),
        *(
            kit.planar(f"to_{b}", "ground", b, position=(2.0 * i, *random.uniform(-0.1, 0.1, 2).tolist()))
            for i, b in enumerate(names)
        ),
        *(
            kit.spring(
                f"{p}_{i}", f"b{i}.{p}", f"b{i + 1}.{q}", stiffness=float(k), damping=damping * float(k),
                force_density=0.0,
            )
            for i in range(n - 1)
            for (p, q), k in zip(ends, laws[i], strict=True)
        ),
        *(kind(name=kind.kind, port=f"{seen}.a1") for kind in kinds),
        kit.force("push", f"{pushed}.b0", (1, 2, 0), frame="ground", magnitude=0.0),
        kit.torque("turn", pushed, (0, 0, 1), magnitude=0.0),
        inputs=["push.force", "turn.torque", "a1_0.force_density"],
    )  # fmt: skip


def attack(seed: int, folder: Path) -> str:
    """One scene at two places of its range; an accelerometer feels gravity in its turn."""
    random, is_free = np.random.default_rng(seed), seed % 3 == 2
    scene = bodies_apart(random) if seed % 6 == 5 else scene_of(random, is_free=is_free)
    model = mbdlft.to_lft(scene, search=0.0, prove=0.0)
    if is_free:
        both = np.append(OMEGA, OMEGA * (1.0 + STEP))
        truth, beside = np.split(problem_of_scene(scene).reference().transfers_in_digits([0], both)[0], 2)
        slopes = np.abs(beside - truth) / STEP  # a zero of an entry has the digits of its frequency
        found = mbdlft.frequency_response(model, {}, OMEGA)[0]
        units = np.array([signal.unit for signal in model.outputs])
        for unit in {*units.tolist()}:
            errors, sizes = (np.abs(x[:, units == unit]) for x in (found - truth, truth))
            largest = np.max(np.maximum(sizes, slopes[:, units == unit]), axis=1, keepdims=True)
            right = errors <= MOST * largest
            assert np.all(right), (seed, model.order, unit, *np.argwhere(~right)[0])
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
