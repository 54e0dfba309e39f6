"""Robots that people have, from their URDF files, against pinocchio and MuJoCo.

Joint angles, masses and lengths are parameters of one model; the other tools are asked again at each
value.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import mbdlft
from benchmarks import ur5 as benchmark
from benchmarks.cases.robots import Rest, by_mujoco, by_pinocchio, edited, robots
from mbdlft.robot.load import RIGHT_ANGLE, read_robot
from mbdlft.robot.make import AXIAL
from mbdlft.robot.robot import RobotJoint
from scenarios import ur5
from tests.close import MUJOCO, PINOCCHIO, target

try:
    for package in ("example-robot-data", "mujoco", "pin"):
        distribution(package)
except PackageNotFoundError:
    pytest.skip("no robots are installed: pip install -e '.[robots]'", allow_module_level=True)

COUNT = 20


class Robot(NamedTuple):
    """A file, how many of its joint angles are parameters, and which of its numbers."""

    file: str
    angles: int
    vary: tuple[str, ...] = ()
    payload: str = ""
    free: bool = False


ROBOTS = {
    "ur5": Robot(
        "ur_description/urdf/ur5_robot.urdf",
        6,
        ("forearm_link.mass", "forearm_link.inertia.zz", "elbow_joint.origin.z"),
        "tool0.mass",
    ),
    "panda": Robot("panda_description/urdf/panda.urdf", 7, ("panda_hand.mass",)),
    "xarm7": Robot("xarm_description/urdf/xarm7.urdf", 7),
    "kinova": Robot("kinova_description/robots/kinova.urdf", 6),
    "anymal": Robot("anymal_b_simple_description/robots/anymal.urdf", 12),
    "anymal_free": Robot("anymal_b_simple_description/robots/anymal.urdf", 3, free=True),
    "talos_free": Robot("talos_data/robots/talos_reduced.urdf", 2, free=True),
    "anymal_c": Robot("anymal_c_simple_description/urdf/anymal.urdf", 6),
    "talos": Robot("talos_data/robots/talos_full_v2.urdf", 4),
    "talos_arm": Robot("talos_data/robots/talos_left_arm.urdf", 7),
    "allegro": Robot("allegro_hand_description/urdf/allegro_right_hand.urdf", 4),
    "baxter": Robot("baxter_description/urdf/baxter.urdf", 4),
    "tiago": Robot("tiago_description/robots/tiago_no_hand.urdf", 4),
    "pr2": Robot("pr2_description/urdf/pr2.urdf", 3),
    "g1": Robot("g1_description/urdf/g1_29dof_rev_1_0.urdf", 4),
    "so101": Robot("so_arm_description/urdf/so101.urdf", 6),
}


class Case(NamedTuple):
    """A model at points of its parameters, and what the other tools are told."""

    path: Path
    free: bool
    model: mbdlft.LFTModel
    points: dict[str, np.ndarray]
    angles: Mapping[str, str]  # parameter of a joint
    numbers: Mapping[str, str]  # parameter of a label
    constants: Mapping[str, float]  # position of a joint


def span(joint: RobotJoint) -> tuple[float, float]:
    """Inside the limits, and at most 1.5 to either side of their middle."""
    if joint.lower is None or joint.upper is None:
        return -1.5, 1.5
    middle, half = (joint.lower + joint.upper) / 2, 0.45 * (joint.upper - joint.lower)
    return middle - min(half, 1.5), middle + min(half, 1.5)


@cache
def case(name: str) -> Case:
    return case_of(ROBOTS[name])


def case_of(robot: Robot, right_angle: float = RIGHT_ANGLE) -> Case:
    path = robots() / robot.file
    generator = np.random.default_rng(len(robot.file))
    axial = [joint for joint in read_robot(path).joints.values() if joint.kind in AXIAL]
    hinges = [joint.name for joint in axial if joint.kind != "prismatic"]
    chosen = sorted(generator.permutation(hinges)[: robot.angles])
    spans = {joint.name: span(joint) for joint in axial}
    angles = {joint: f"q{k}" for k, joint in enumerate(chosen)}
    constants = {joint: generator.uniform(*ends) for joint, ends in spans.items() if joint not in angles}
    parameters = []
    for joint, angle in angles.items():
        low, high = spans[joint]
        parameters.append(mbdlft.Angle(angle, 0.6 * low + 0.4 * high, low, high, unit="rad"))
    values = {f"{joint}.position": value for joint, value in (angles | constants).items()}
    numbers = {label: label.replace(".", "_") for label in robot.vary}
    if robot.payload:
        parameters.append(mbdlft.Parameter("payload", 2.5, 0.0, 5.0, unit="kg"))
        values[robot.payload] = numbers[robot.payload] = "payload"
    scene, _ = mbdlft.load_robot(
        path,
        parameters=parameters,
        values=values,
        base="free" if robot.free else "fixed",
        vary=dict.fromkeys(robot.vary, 20.0),
        keep_unphysical=True,
        right_angle=right_angle,
    )
    model = mbdlft.to_lft(scene, search=0.0)
    points = mbdlft.random(model.parameters, COUNT, seed=1)
    return Case(path, robot.free, model, points, angles, numbers, constants)


def told(case: Case, k: int) -> tuple[str, dict[str, float]]:
    """The file and the positions at one point."""
    numbers = {label: float(case.points[name][k]) for label, name in case.numbers.items()}
    positions = {joint: float(case.points[name][k]) for joint, name in case.angles.items()}
    return edited(case.path, numbers), dict(case.constants) | positions


def compare(case: Case, tool: Callable[..., Rest], count: int, bound: float) -> None:
    """[A B] and the trim of the model are those of the other tool, within a relative error.

    Joints are in units in which their own entry of M is one; each part that acts on q, qdot and
    the efforts is relative to its largest entry.
    """
    model, efforts = case.model, mbdlft.trim_at(case.model, case.points)
    A, B, _, _ = mbdlft.matrices_at(model, case.points)
    own = [coordinate(signal.name) for signal in model.inputs if signal.name[:5] != "hold_"]
    trimmed = [coordinate(signal.name) for signal in model.trim.signals]
    n = len(own)
    G, moving = following(case, own)
    m = len(moving)
    for k in range(count):
        rest = tool(*told(case, k), free=case.free)
        place = {name.replace(".", "_"): row for row, name in enumerate(rest.coordinates)}
        order = [place[name] for name in own]
        M, K, D = (G.T @ matrix[np.ix_(order, order)] @ G for matrix in (rest.M, rest.K, rest.D))
        unit = np.sqrt(np.diag(M))[:, None]
        inverse = np.linalg.inv(M)
        target(unit * B[k, m:, :n], unit * inverse @ G.T, bound)
        target(unit * A[k, m:, :m] / unit.T, -unit * (inverse @ K) / unit.T, bound)
        target(unit * A[k, m:, m:] / unit.T, -unit * (inverse @ D) / unit.T, bound)
        wanted = {f"{name}_mimic": rest.effort[place[name]] for name in own if name not in moving}
        wanted |= {name: rest.effort[place[name]] for name in trimmed if name in place}
        wanted |= dict(zip(moving, G.T @ rest.effort[order], strict=True))
        target(efforts[k], np.array([wanted[name] for name in trimmed]), bound)


def following(case: Case, own: list[str]) -> tuple[np.ndarray, list[str]]:
    """Displacements of all joints by those that do not mimic another one, and the names of these."""
    joints = [joint for joint in read_robot(case.path).joints.values() if joint.mimic]
    mimics = {joint.name.replace(".", "_"): joint.mimic for joint in joints}
    moving = [name for name in own if name not in mimics]
    G = np.array([[float(name == other) for other in moving] for name in own])
    for row, name in enumerate(own):
        if name in mimics:
            leader, multiplier, _ = mimics[name]
            G[row, moving.index(leader.replace(".", "_"))] = multiplier
    return G, moving


def coordinate(signal: str) -> str:
    """Name in `Rest` of the coordinate of an effort, or of a load that holds the root; no dots."""
    if signal.startswith("hold_"):
        _, kind, axis = signal.partition(".")[0].split("_")
        return f"root_joint_{kind}_{axis}"
    return re.sub(r"\.(torque|force)$", "", signal).replace(".", "_")


QUICK = ("ur5", "anymal_free", "allegro", "so101")  # one of each kind


def quick_first(names: Iterable[str], without: str = "") -> list[Any]:
    """Parameters of a test; robots that are large, or of the same kind, run with the long tests."""
    quick = {*QUICK} - {without}
    return [pytest.param(name, marks=[] if name in quick else [pytest.mark.long]) for name in names]


@pytest.mark.parametrize("name", quick_first(ROBOTS, without="ur5"))
def test_robot_equals_pinocchio(name: str) -> None:
    compare(case(name), by_pinocchio, COUNT, PINOCCHIO)


@pytest.mark.parametrize("name", quick_first(["ur5", "panda", "xarm7", "so101"]))
def test_robot_equals_mujoco(name: str) -> None:
    compare(case(name), by_mujoco, 5, MUJOCO)


@pytest.mark.parametrize("name", quick_first(["ur5", "kinova", "talos_arm"]))
def test_file_as_it_stands_equals_pinocchio(name: str) -> None:
    """No angle is taken as a right one, and the other tool reads the file itself."""
    robot = ROBOTS[name]._replace(angles=1, vary=(), payload="")
    found = case_of(robot, right_angle=0.0)
    text = found.path.read_text(encoding="utf-8")
    compare(found, lambda _, *told, **free: by_pinocchio(text, *told, **free), 3, PINOCCHIO)


def test_scenario_is_that_of_its_script(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    written = ur5.TOML.read_text(encoding="utf-8")
    monkeypatch.setattr(ur5, "TOML", tmp_path / "ur5.toml")
    monkeypatch.setattr(ur5, "to_lft", lambda scene: mbdlft.to_lft(scene, search=0.0, prove=0.0))
    monkeypatch.setattr("sys.argv", ["ur5.py"])
    ur5.main()
    assert (tmp_path / "ur5.toml").read_text(encoding="utf-8") == written
    assert len(capsys.readouterr().out.splitlines()) == 8 + 1 + 9


def test_benchmark_at_its_smallest() -> None:
    text = benchmark.table(robots() / ROBOTS["ur5"].file, 0.0, repeats=1)
    assert "| of which check |" in text
