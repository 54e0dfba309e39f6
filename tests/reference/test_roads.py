"""Motions as inputs: a half car on a road in closed form, and the same motion by its acceleration.

    M q'' + C q' + K q = K_t r + C_t r',      q = [hop front, hop rear, heave, pitch]

Source of the model: Gillespie, Fundamentals of Vehicle Dynamics (1992), chapter 5.
"""

import numpy as np
import pytest

import mbdlft
from mbdlft import Scene, Spring
from mbdlft.base.errors import SceneError
from tests import kit
from tests.close import CLOSED_FORM, CROSS, target
from tests.cross.mechanisms import closed_loop, open_tree
from tests.cross.test_mechanism import equals_truth, points_of

FRONT, REAR = 1.1, 1.4
AXLES = np.array([[1, 0, -1, FRONT], [0, 1, -1, -REAR]], dtype=float)  # elongation of the struts


def half_car() -> Scene:
    return mbdlft.load_scene("scenarios/half_car.toml")


def by_hand(point: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """[A B] of the accelerations (4, 8) and (4, 4), road inputs [front, front', rear, rear']."""
    m, k, c, tire = point["m"], 1e3 * point["k"], 1e3 * point["c"], 1e3 * point["k_tire"]
    M = np.diag([38.0, 34.0, m, 1.9 * m])
    hop = np.diag([1.0, 1.0, 0.0, 0.0])
    K = AXLES.T @ np.diag([k, 1.2 * k]) @ AXLES + tire * hop
    C = AXLES.T @ np.diag([c, c]) @ AXLES + 150.0 * hop
    road = np.zeros((4, 4))
    road[0, :2], road[1, 2:] = (tire, 150.0), (tire, 150.0)
    return -np.linalg.solve(M, np.hstack([K, C])), np.linalg.solve(M, road)


def law_half_car() -> None:
    scene = half_car()
    model = mbdlft.to_lft(scene, search=0.0)
    assert [s.name for s in model.states][:4] == [
        "front_hop.position",
        "rear_hop.position",
        "heave.position",
        "pitch.angle",
    ]
    for point in points_of(scene):
        A, B, C, D = mbdlft.matrices_at(model, point)
        slopes, road = by_hand(point)
        target(A[4:], slopes, CLOSED_FORM)
        target(B[4:], road, CLOSED_FORM)
        target(C[2], slopes[2] - 0.2 * slopes[3], CLOSED_FORM)
        target(D[2], road[2] - 0.2 * road[3], CLOSED_FORM)
        # the tires carry everything
        trim = dict(
            zip([s.name for s in model.trim.signals], np.ravel(mbdlft.trim_at(model, point)), strict=True)
        )
        share = point["m"] * np.array([REAR, FRONT]) / (FRONT + REAR)
        tires = 9.81 * (share + np.array([38.0, 34.0]))
        found = [trim["front_tire.force"], trim["rear_tire.force"]]
        target(found, tires, CLOSED_FORM)


def test_half_car_is_that_of_the_book_and_minimal() -> None:
    law_half_car()
    model = mbdlft.to_lft(half_car())
    assert model.certificate.minimal
    assert len(model.states) == 8


def moved(base: Scene, k: int, how: bool | str) -> Scene:
    """A scene with one joint imposed, and all inputs of its motion."""
    joints = list(base.joints)
    joints[k] = joints[k].model_copy(update={"imposed": how, "preload": None})
    name, orders = joints[k].name, (0, 1, 2) if how == "motion" else (2,)
    inputs = [f"{name}.{f.measures[order].name}" for f in joints[k].freedoms for order in orders]
    sensors = [s for sensor in base.sensors[:3] for s in sensor.signals()]
    outputs = [f"{joints[0].name}.{f.measures[2].name}" for f in joints[0].freedoms]
    return base.model_copy(
        update={
            "joints": tuple(joints),
            "inputs": tuple(inputs),
            "outputs": tuple([*outputs, *(s.name for s in sensors)]),
        }
    )


def test_motions_in_trees_equal_maximal_coordinates() -> None:
    model = equals_truth(moved(open_tree(3), 1, "motion"))
    assert not any(s.name.startswith("j1.") for s in model.states)


def same_motion(base: Scene, k: int) -> None:
    """G_q/s^2 + G_v/s + G_a is the transfer of the acceleration, which has states for the motion."""
    by_motion = mbdlft.to_lft(moved(base, k, "motion"), search=0.0)
    by_acceleration = mbdlft.to_lft(moved(base, k, True), search=0.0)
    assert len(by_motion.states) == len(by_acceleration.states) - 2 * len(base.joints[k].freedoms)
    s = np.array([0.3 + 1.1j, 2.0 - 0.4j, 5.0])
    for point in points_of(base):
        value, wanted = (
            _transfer(mbdlft.matrices_at(model, point), s) for model in (by_motion, by_acceleration)
        )
        parts = value.reshape(len(s), value.shape[1], -1, 3)
        factors = s[:, None, None, None] ** np.array([-2.0, -1.0, 0.0])
        found = np.sum(parts * factors, axis=-1)
        scale = float(np.max(np.abs(wanted)))
        target(found.real, wanted.real, CROSS, scale)
        target(found.imag, wanted.imag, CROSS, scale)


def _transfer(system, s: np.ndarray) -> np.ndarray:
    A, B, C, D = system
    return np.array([C @ np.linalg.solve(point * np.eye(len(A)) - A, B) + D for point in s])


@pytest.mark.long
def test_motion_is_that_of_its_acceleration() -> None:
    """In trees, and where a loop follows the joint that is moved."""
    same_motion(open_tree(4), 0)
    loop = closed_loop(1)
    free = [k for k, joint in enumerate(loop.joints) if getattr(joint, "preload", None) is None]
    same_motion(loop, free[0])


def table(**fields) -> Scene:
    """A mass on a spring, on a table that is moved; another spring holds it to the ground."""
    return kit.scene(
        "table",
        mbdlft.Ground(ports={"wall": (2.0, 0, 0)}),
        kit.point("table", 3.0),
        kit.point("load", 1.0),
        kit.rail("shake", "ground", "table", (1, 0, 0), imposed="motion"),
        kit.rail("slide", "table", "load", (1, 0, 0), stiffness=9.0, damping=1),
        **fields,
    )


def stay(**fields) -> Spring:
    return kit.spring("stay", "ground.wall", "load", force_density=0, **fields)


def test_inputs_are_those_that_are_felt() -> None:
    """On the table the mass feels the acceleration only; a spring or a damper to the wall feels more."""
    assert _inputs(table()) == ["slide.force", "shake.acceleration"]
    sprung = [stay(stiffness=5.0)]
    assert _inputs(table(loads=sprung))[2:] == ["shake.position", "shake.acceleration"]
    both = [stay(stiffness=5.0, damping=2.0)]
    assert _inputs(table(loads=both))[2:] == ["shake.position", "shake.velocity", "shake.acceleration"]
    seen = [mbdlft.Velocity(name="seen", port="load")]
    assert _inputs(table(sensors=seen))[1:] == ["shake.velocity", "shake.acceleration"]


def test_an_input_whose_column_is_zero_is_not_demanded() -> None:
    """The rate of steering is in the slip of a tire, and cancels where its side force lags."""
    tire = {"axis": (0, 1, 0), "radius": 0.3, "force": 0.0, "cornering": 9e4}

    def steered(**law: float) -> Scene:
        return kit.scene(
            "steered",
            kit.point("car", 700.0, ports={"hub": (0, 0, 0.3)}),
            kit.point("fork", 0.0),
            kit.rail("side", "ground", "car", (0, 1, 0), preload=0.0),
            kit.hinge("steer", "car.hub", "fork", (0, 0, 1), imposed="motion"),
            mbdlft.Tire(name="front", child="fork", **tire, **law),
            velocity=(20.0, 0, 0),
            inputs=["steer.angle"],
        )

    scene = steered(relaxation=0.5)
    assert _inputs(scene) == _inputs(scene.model_copy(update={"inputs": None}))[-1:] == ["steer.angle"]
    both = scene.model_copy(update={"inputs": ("steer.angle", "steer.rate")})
    zero = mbdlft.to_lft(both, search=0.0).at({})
    assert zero.B[:, 0].any()
    assert not np.vstack([zero.B, zero.D])[:, 1].any()


def _inputs(scene: Scene) -> list[str]:
    return [signal.name for signal in mbdlft.to_lft(scene, search=0.0).inputs]


def test_a_motion_without_a_part_that_is_felt_is_refused() -> None:
    scene = table(loads=[stay(damping=2.0)], inputs=["shake.velocity"])
    with pytest.raises(SceneError) as caught:
        mbdlft.to_lft(scene)
    assert "inputs: shake.velocity moves something that also feels shake.acceleration" in str(
        caught.value
    )
    held = table(loads=[stay(damping=2.0)], inputs=["slide.force"])  # the table stands still
    assert _inputs(held) == ["slide.force"]
    more = table(inputs=["shake.position", "shake.acceleration"])  # what is not felt does nothing
    assert not mbdlft.to_lft(more, search=0.0).at({}).B[:, 0].any()


def test_a_loop_that_only_a_motion_could_close_is_refused() -> None:
    loop = kit.loop("pin", "spherical", "ground", "table")
    scene = table(loops=[loop])
    only = scene.model_copy(update={"joints": scene.joints[:1], "bodies": scene.bodies[:2]})
    with pytest.raises(SceneError, match="nothing else is left that could follow"):
        mbdlft.assemble(only)


def test_the_word_is_checked() -> None:
    with pytest.raises(SceneError, match="imposed: expected true, false or 'motion', got 'moved'"):
        kit.hinge("a", "ground", "b", (0, 0, 1), imposed="moved")
