"""The acceleration of the frame as an unknown of the trim: thrust over mass, and free fall."""

import numpy as np
import pytest

import mbdlft
from mbdlft import Parameter, RigidBody, Scene
from mbdlft.base.errors import SceneError, TrimError
from tests import kit
from tests.close import CLOSED_FORM, target
from tests.cross.test_mechanism import equals_truth, points_of

LAUNCHER = "scenarios/launcher_slosh.toml"
THRUST = Parameter("T", 1500.0, percent=10, unit="kN")
SHARED = ("m_stage", "m_slosh", "L_slosh", "z_center")


def launcher() -> tuple[Scene, Scene]:
    """With the acceleration given and the thrust unknown, and the other way round."""
    given = mbdlft.load_scene(LAUNCHER)
    (thrust,) = given.loads
    fields = {key: getattr(given, key) for key in Scene.model_fields}
    fields |= {
        "loads": (thrust.model_copy(update={"magnitude": "T"}),),
        "parameters": (*(p for p in given.parameters if p.name in SHARED), THRUST),
        "acceleration": (0.0, 0.0, "unknown"),
    }
    return given, Scene(**fields)


def test_launcher_accelerates_by_thrust_over_mass() -> None:
    """a = T/(all masses) - g, and the model is that of a scene with this acceleration."""
    given, free = launcher()
    by_acceleration = mbdlft.to_lft(given, search=0.0)
    model = mbdlft.to_lft(free)
    assert model.certificate.minimal
    for point in points_of(free):
        mass = 1e3 * (point["m_stage"] + point["m_slosh"]) + 900.0
        a = 1e3 * point["T"] / mass - 9.81
        target(np.ravel(mbdlft.trim_at(model, point)), [a], CLOSED_FORM)
        same = {name: point[name] for name in SHARED} | {"a": a}
        for found, wanted in zip(
            mbdlft.matrices_at(model, point), mbdlft.matrices_at(by_acceleration, same), strict=True
        ):
            target(found, wanted, CLOSED_FORM)


def dropped() -> Scene:
    """A box that falls freely, with a pendulum on a spring in it."""
    box = kit.body("box", "m", (2, 3, 4), ports={"eye": (0, 0, 0.5)})
    return kit.scene(
        "dropped",
        Parameter("m", 9.0, percent=30, unit="kg"),
        Parameter("L", 0.4, percent=20, unit="m"),
        box,
        kit.point("bob", 2.0, ports={"eye": (0, 0, "L")}),
        kit.free("fall", "ground", "box", preload=(0, 0, 0, 0, 0, 0)),
        kit.cross("pivot", "box.eye", "bob.eye", axis1=(1, 0, 0), axis2=(0, 1, 0), preload=(0, 0)),
        gravity=(0, 0, -9.81),
        acceleration=(0, 0, "unknown"),
        inputs=["pivot.torque.1"],
        outputs=["pivot.angle.1"],
    )


def test_nothing_swings_in_free_fall() -> None:
    scene = dropped()
    model = mbdlft.to_lft(scene, search=0.0)
    for point in points_of(scene):
        target(np.ravel(mbdlft.trim_at(model, point)), [-9.81], CLOSED_FORM)
        A = mbdlft.matrices_at(model, point).A
        target(np.max(np.abs(A[len(A) // 2 :])), 0.0, CLOSED_FORM, 1.0)


def thrust_in_space() -> Scene:
    """A body under oblique thrust with a tilted arm, free in space: its trim is what balances it."""
    hull = kit.body(
        "hull",
        "m",
        (2, 3, 4),
        xy=0.2,
        center_of_mass=(0.1, 0, 0.2),
        ports={"motor": (0, 0, -0.6), "arm": (0.2, 0, 0.7)},
    )
    arm = kit.body("arm", 1.5, (0.1, 0.2, 0.2), center_of_mass=(0.3, 0, 0.1))
    return kit.scene(
        "thrust_in_space",
        Parameter("m", 9.0, percent=30, unit="kg"),
        Parameter("T", 120.0, percent=30, unit="N"),
        mbdlft.Angle("q", 25.0, low=-30.0, high=60.0),
        *(_point(name) for name in ("sx", "sy", "sz")),
        hull,
        arm,
        kit.rail("x", "ground", "sx", (1, 0, 0), preload=0),
        kit.rail("y", "sx", "sy", (0, 1, 0), preload=0),
        kit.rail("z", "sy", "sz", (0, 0, 1), preload=0),
        kit.ball("turn", "sz", "hull"),
        kit.hinge("elbow", "hull.arm", "arm", (0, 1, 0), position="q", stiffness=5.0, damping=0.2),
        kit.force("thrust", "hull.motor", (0.2, 0.1, 1.0), magnitude="T"),
        mbdlft.Accelerometer(name="imu", port="arm"),
        gravity=(0.3, -1.0, -9.0),
        acceleration=("unknown", "unknown", "unknown"),
        inputs=["thrust.force", "ground.acceleration.z", "elbow.torque"],
        outputs=["elbow.angle", "imu.x", "imu.y", "imu.z"],
    )


def _point(name: str) -> RigidBody:
    return kit.body(name, 0.0, (0, 0, 0))


def test_thrust_in_space_equals_maximal_coordinates() -> None:
    scene = thrust_in_space()
    model = equals_truth(scene)
    assert {"ground.acceleration.x", "turn.torque.y"} <= {s.name for s in model.trim.signals}


def test_acceleration_that_nothing_determines() -> None:
    scene = dropped()
    held = scene.joints[0].model_copy(update={"preload": None})
    scene = scene.model_copy(update={"joints": (held, scene.joints[1])})
    with pytest.raises(TrimError, match="redundant") as caught:
        mbdlft.to_lft(scene)
    assert "ground.acceleration.z" in str(caught.value)
    assert "fall.force.z" in str(caught.value)


def test_the_word_is_not_a_name() -> None:
    named = Parameter("unknown", 1.0, percent=10, unit="m/s^2")
    with pytest.raises(SceneError, match="'unknown' stands for a component that the trim solves"):
        kit.scene("s", named, acceleration=(0, 0, "unknown"))


def test_an_equilibrium_is_found_with_it() -> None:
    """The elbow of a thrown arm: positions and the acceleration together."""
    _, free = launcher()
    point = mbdlft.find_equilibrium(free, {"T": 1500.0})
    target(point.efforts["ground.acceleration.z"], 1500e3 / 64900.0 - 9.81, CLOSED_FORM)
