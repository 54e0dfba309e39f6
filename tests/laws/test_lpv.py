"""Scheduled controllers by matrix inequalities: least gammas in closed form, loops anew, proofs."""

from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest

import mbdlft
from mbdlft.export import export_model
from mbdlft.synthesis import (
    fitted_values,
    gain_goal,
    load_tuning,
    lpv,
    lpv_synthesis,
    reduced_structure,
    scheduled,
    tracking_goal,
    tunable_gain,
    tunable_state_space,
    tunable_system,
)
from mbdlft.synthesis.bound import full_order_bound
from mbdlft.synthesis.loop import network
from mbdlft.system import state_space
from tests.close import CLOSED_FORM, CROSS, REDUCED, target
from tests.laws.test_synthesis import transfer

K = mbdlft.Parameter("k", 2.0, low=1.0, high=3.0, unit="N/m", role="scheduled")
SPRING = mbdlft.realize(
    [["0", "1", "0"], ["-k", "-0.1", "1"], ["1", "0", "0"]],
    [K], states=2, inputs=["f"], outputs=["y"], name="plant", search=0.0, prove=0.0,
)  # fmt: skip
GOALS = [
    tracking_goal("r", "e", time=2.0, dc=1e-2, peak=1.5, name="tracking"),
    gain_goal("r", "u", limit=30.0, name="effort"),
]
LOOP = {"f": "u", "e": ["r", "-y"]}
POINTS = {"k": np.random.default_rng(3).uniform(1.0, 3.0, 12)}


@pytest.fixture(scope="module")
def made() -> mbdlft.ScheduledSynthesis:
    return lpv_synthesis([SPRING, tunable_gain("K", "e", "u")], GOALS, LOOP, work=3.0)


def largest(system: mbdlft.System, values: dict[str, np.ndarray]) -> np.ndarray:
    """Largest singular values on a dense grid of frequencies, at points."""
    A, B, C, D = mbdlft.matrices_at(system, values)
    assert np.max(np.linalg.eigvals(A).real) < 0.0
    s = 1j * np.geomspace(1e-4, 1e5, 700)[:, None, None, None] * np.eye(A.shape[-1])
    return np.max(np.linalg.norm(C @ np.linalg.solve(s - A, B + 0.0 * s[..., :1]) + D, 2, (2, 3)), axis=0)


def test_a_structure_begins_at_a_controller_of_full_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reduced to its states: other starts end in minima of a flexible structure that are far above."""
    random, n = np.random.default_rng([8, 13]), 8
    w = np.sort(10.0 ** random.uniform(0.0, 1.5, n // 2))
    A, B, C = np.zeros((n, n)), np.zeros((n, 3)), np.zeros((3, n))
    for k, frequency in enumerate(w):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, 1.0], [-(frequency**2), -0.01 * frequency]]
    B[1::2, 0], B[1::2, 2], C[0, ::2], C[2, ::2] = (
        random.standard_normal(n // 2) * each for each in (1.0, 1.0, w, w)
    )
    D = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.0, 0.1, 0.0]]
    plant = control.ss(A, B, C, D, name="plant", inputs=["w", "v", "u"], outputs=["z", "zu", "y"])
    systems = [plant, tunable_state_space("K", "e", "d", 2, speed=5.0)]
    given = systems, [gain_goal(["w", "v"], ["z", "zu"])], {"e": "y", "u": "d"}
    found = []
    for is_given in (True, False):
        made = mbdlft.tune(*given, starts=2, prove=False)
        assert made.controllers[0].order == 0
        found.append(made.goals[0].tuned)
        if is_given:
            monkeypatch.setattr(lpv, "_QUICK", 0)
    assert found[0] < 0.8 * found[1]


def test_least_gamma_in_closed_form() -> None:
    """z = (theta_i x_i + u_i, c u_i), y = x: u = -theta x/(1 + c^2), c/sqrt(1 + c^2) of |theta x|."""
    c, thetas = 0.75, [mbdlft.Parameter(n, 0.0, low=-1.0, high=1.0, role="scheduled") for n in "ab"]
    matrix = [
        ["-1", "0", "1", "0", "0", "0"], ["0", "-1", "0", "1", "0", "0"],
        ["a", "0", "0", "0", "1", "0"], ["0", "0", "0", "0", "0.75", "0"],
        ["0", "b", "0", "0", "0", "1"], ["0", "0", "0", "0", "0", "0.75"],
        ["1", "0", "0", "0", "0", "0"], ["0", "1", "0", "0", "0", "0"],
    ]  # fmt: skip
    signals = {"inputs": ["w1", "w2", "u1", "u2"], "outputs": ["z1", "z2", "z3", "z4", "y1", "y2"]}
    plant = mbdlft.realize(matrix, thetas, states=2, name="P", search=0.0, prove=0.0, **signals)
    gain, goal = (
        tunable_gain("K", ["e1", "e2"], ["v1", "v2"]),
        gain_goal(["w1", "w2"], ["z1", "z2", "z3", "z4"]),
    )
    wired = {"u1": "v1", "u2": "v2", "e1": "y1", "e2": "y2"}
    found = lpv_synthesis([plant, gain], [goal], wired, slack=0.01, work=1.0)
    least = c / np.sqrt(1.0 + c**2)
    assert abs(found.least - least) < 1e-4
    assert least <= found.motion.upper <= 1.0101 * least
    assert mbdlft.verify(found.loop, found.motion) == ""
    half = lpv_synthesis([plant, gain], [goal], wired, measured=["a"], slack=0.01, prove=False, work=1.0)
    assert abs(half.least - least) < 1e-4  # b is nominal, 0
    assert half.tuning.goals[0].worst > 0.99  # and not in the box


def test_without_ranges_it_is_the_least_h_infinity_norm(made: mbdlft.ScheduledSynthesis) -> None:
    gain = tunable_gain("K", "e", "u")
    net = network([SPRING, gain], LOOP, GOALS)
    bound = full_order_bound(net, GOALS) / 0.99
    nominal = lpv_synthesis([SPRING, gain], GOALS, LOOP, measured=[], prove=False, work=1.0)
    narrow = SPRING.with_range(k=(2.0 - 1e-4, 2.0 + 1e-4))  # digits are lost where it is narrower
    small = lpv_synthesis([narrow, gain], GOALS, LOOP, prove=False, work=1.0)
    for found in (nominal, small):
        assert abs(found.least / bound - 1.0) < 1e-3  # 7e-5 by any kernel
        assert found.motion.upper <= found.gamma < 1.031 * bound
    assert not nominal.structure.frame.parameters
    # at each frozen point, no controller is better than the bound there
    values = np.array([-1.0, -0.3, 0.6, 1.0])
    at_points = [full_order_bound(net, GOALS, np.array([v])) for v in values]
    gains = largest(made.loop, {"k": 2.0 + values})
    assert np.all(np.array(at_points) < gains)
    assert np.max(gains) <= made.gamma


def test_loops_anew(made: mbdlft.ScheduledSynthesis, tmp_path: Path) -> None:
    """Of connect, at random points: below what is proved, with all goals at once below gamma."""
    controller = made.tuning.controllers[0]
    whole = mbdlft.connect([SPRING, controller], LOOP, inputs=["r"], outputs=["e", "u"])
    weight = GOALS[0].after
    assert weight is not None
    scale = state_space(
        weight.A,
        [[1.0, 0.0]] * weight.B_u,
        [[1.0], [0.0]] * weight.C_y,
        np.diag([weight.D_yu.item(), 1.0 / 30.0]),
    )
    gains = largest(scale * whole, POINTS)
    assert np.all(gains <= made.gamma)
    target(np.sort(gains), np.sort(largest(made.loop, POINTS)), CROSS)
    for row, reached in enumerate(made.tuning.goals):
        assert np.max(largest((scale * whole)[row, :], POINTS)) <= reached.proved <= made.gamma
        assert mbdlft.verify(reached.loop, reached.bounds[0]) == ""
    assert made.motion.proved
    assert made.motion.rates == {"k": np.inf}
    assert mbdlft.verify(made.loop, made.motion) == ""
    mbdlft.save_analysis(tmp_path / "made.h5", made.loop, made.motion)
    assert mbdlft.verify(*mbdlft.load_analysis(tmp_path / "made.h5")) == ""


@pytest.mark.parametrize("seed", range(2))
def test_random_plants_with_direct_paths(seed: int) -> None:
    random = np.random.default_rng(seed)
    thetas = [mbdlft.Parameter(name, 0.0, low=-1.0, high=1.0, role="scheduled") for name in "ab"]
    sizes = {"inputs": ["w", "d", "u1", "u2"], "outputs": ["z", "v", "y1", "y2"]}
    matrix = random.standard_normal((7, 7)).round(2).astype(str).astype(object)
    matrix[3:5, 3:5] = "0"
    for i, j in random.integers(0, 3, (4, 2)):
        matrix[i, j] += f" + {random.uniform(0.2, 0.5):.2f}*{random.choice(['a', 'b', 'a*b'])}"
    plant = mbdlft.realize(matrix.tolist(), thetas, states=3, name="P", search=0.0, prove=0.0, **sizes)
    goals = [gain_goal("w", ["z", "v"], limit=3.0), gain_goal("d", "z")]
    gain = tunable_gain("K", ["e1", "e2"], ["k1", "k2"])
    wired = {"u1": "k1", "u2": "k2", "e1": "y1", "e2": "y2"}
    found = lpv_synthesis([plant, gain], goals, wired, prove=False, work=1.0)
    assert mbdlft.verify(found.loop, found.motion) == ""
    controller = found.tuning.controllers[0]
    whole = mbdlft.connect([plant, controller], wired, inputs=["w", "d"], outputs=["z", "v"])
    points = {name: random.uniform(-1.0, 1.0, 20) for name in "ab"}
    for goal in goals:
        gains = largest(whole[list(goal.outputs), list(goal.inputs)], points)
        assert np.max(gains) / goal.limit <= found.gamma


def test_a_controller_is_a_structure(made: mbdlft.ScheduledSynthesis) -> None:
    controller = made.tuning.controllers[0]
    again = tunable_system(controller).with_values({})
    parts = [SPRING, made.structure]
    same = reduced_structure(parts, GOALS, LOOP, states=3).with_values({})
    for k in (1.1, 2.0, 2.7):
        expected = transfer(controller, k=k)
        target(transfer(again, k=k), expected, CLOSED_FORM)
        target(transfer(same, k=k), expected, CROSS)
    small = reduced_structure(parts, GOALS, LOOP, states=2, repetitions=1)
    loop = mbdlft.connect([SPRING, small.with_values({})], LOOP, inputs=["r"], outputs=["e", "u"])
    whole = mbdlft.connect([SPRING, controller], LOOP, inputs=["r"], outputs=["e", "u"])
    assert len(loop.states) == 4
    for channel in ("e", "u"):
        target(largest(loop[channel, :], POINTS), largest(whole[channel, :], POINTS), REDUCED)


@pytest.mark.long
def test_a_schedule_is_better_than_any_fixed_controller_found(made: mbdlft.ScheduledSynthesis) -> None:
    small = reduced_structure([SPRING, made.structure], GOALS, LOOP, states=2)
    affine = scheduled(tunable_state_space("K", "e", "u", 2), [K], ["k", "k^2"])
    start = fitted_values(affine, small.with_values({}))
    one = mbdlft.tune([SPRING, affine], GOALS, LOOP, starts=1, initial=start)
    fixed = mbdlft.tune(
        [SPRING, tunable_state_space("K", "e", "u", 3)], GOALS, LOOP, starts=4, prove=False
    )
    assert max(reached.proved for reached in one.goals) < 0.95 * fixed.soft


@pytest.mark.long
def test_the_arm_while_its_angles_move() -> None:
    """Seed 000, VI.D, at nominal masses: both goals, which are 1 at the printed gains."""
    task = load_tuning("scenarios/tasks/arm_scheduled.toml")
    model = mbdlft.to_lft(mbdlft.load_scene("scenarios/tasks/arm_upright.toml"), search=0.0)
    angles = [name for name in model.parameters.names if name.startswith("theta")]
    narrow = {
        p.name: (p.nominal * (1.0 - 1e-6), p.nominal * (1.0 + 1e-6))
        for p in model.parameters
        if p.name not in angles
    }
    arm, gain = model.with_range(narrow), tunable_gain("K", ["e1", "e2"], ["u1", "u2"])
    how = {"inputs": task.inputs, "measured": angles, "prove": False, "work": 1.0}
    goals = [goal for goal in task.goals if goal.kind != "poles"]
    found = lpv_synthesis([arm, gain], goals, task.connections, **how)
    assert found.motion.upper < 1.26
    assert mbdlft.verify(found.loop, found.motion) == ""
    parts = [arm, found.structure]
    small = reduced_structure(parts, goals, task.connections, states=4, inputs=task.inputs)
    random, inputs = np.random.default_rng(0), ["r1", "r2"]
    points = {p.name: random.uniform(p.low, p.high, 20) for p in model.parameters if p.name in angles}
    for controller in (found.tuning.controllers[0], small.with_values({})):
        whole = mbdlft.connect(
            [model, controller], task.connections, inputs=inputs, outputs=["e1", "e2", "u1", "u2"]
        )
        error, torque = (goal.limit for goal in goals)
        assert goals[0].after is not None
        assert np.max(largest(goals[0].after * whole[:2, :], points)) < 0.95 * error
        assert np.max(largest(whole[2:, :], points)) < 1.05 * torque


def test_room_for_solutions_grows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within half of the least trace nothing satisfies the inequalities."""
    monkeypatch.setattr(lpv, "_TRACES", (0.5, 10.0))
    made = lpv_synthesis([SPRING, tunable_gain("K", "e", "u")], GOALS, LOOP, work=3.0, prove=False)
    assert made.motion.upper < 0.9
    assert mbdlft.verify(made.loop, made.motion) == ""


def test_values_of_another_structure() -> None:
    structure = scheduled(tunable_state_space("K", ["e", "f"], ["u"], 2, speed=3.0), [K], ["k", "k^2"])
    random = np.random.default_rng(4)
    structure = replace(structure, base=random.standard_normal(structure.base.shape))
    values = {value.name: float(random.standard_normal()) for value in structure.free}
    found = fitted_values(structure, structure.with_values(values))
    target([found[name] for name in values], list(values.values()), CROSS)


def test_a_schedule_is_exported(made: mbdlft.ScheduledSynthesis, tmp_path: Path) -> None:
    controller = made.tuning.controllers[0]
    export_model(tmp_path / "K.csv", controller, {"k": 3})
    assert len((tmp_path / "K.csv").read_text().splitlines()) > 3
    export_model(tmp_path / "K.c", controller)
    assert "K_matrices" in (tmp_path / "K.h").read_text()
    polynomials = scheduled(tunable_state_space("K", "e", "u", 3), [K], ["k", "k^2", "k^3"])
    near = polynomials.with_values(fitted_values(polynomials, controller))
    for k in (1.0, 1.7, 3.0):
        assert np.linalg.norm(transfer(near, k=k) - transfer(controller, k=k)) < 1e-2 * np.linalg.norm(
            transfer(controller, k=k)
        )
