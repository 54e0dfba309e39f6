"""Poles, damping, their gradients, and what is said of stability."""

from fractions import Fraction

import control
import mpmath
import mpmath as mp
import numpy as np
import pytest

import mbdlft
from mbdlft import hinf_norm
from mbdlft.exact.rounding import EPS, MOST_ROUNDINGS, eigenvalues_of, eigenvectors_of
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.response.modes import eigenpair, samples_at, spectrum
from tests import kit
from tests.close import CLOSED_FORM, NORM, ROOM, ZEROS, exact, finite_difference, roundoff, target
from tests.light import FINITE, free_flyer, peak_of_60_digits
from tests.oscillators import matrices, oscillator, plain, random_system, spring_and_mass, two_masses


def test_poles_and_table_of_an_oscillator() -> None:
    zeta, omega = 0.03, 5.0
    expected = complex(-zeta * omega, omega * np.sqrt(1.0 - zeta**2))
    found = mbdlft.damping_table(oscillator(zeta, omega))
    target(found.poles, [[expected, expected.conjugate()]], CLOSED_FORM)
    (row,) = found.rows()
    target(row.pole, expected, CLOSED_FORM)
    numbers = [row.natural_frequency, row.frequency, row.damping, row.time_constant]
    expected_numbers = [omega, omega / (2.0 * np.pi), zeta, 1.0 / (zeta * omega)]
    target(numbers, expected_numbers, CLOSED_FORM)
    for name, value in zip(
        ("natural_frequency", "frequency", "damping", "time_constant"), numbers, strict=True
    ):
        target(getattr(found, name), [[value, value]], CLOSED_FORM)
    assert found.stability() == "stable"
    assert "0.03" in str(found)


def test_poles_of_samples_are_those_of_each_alone() -> None:
    model = spring_and_mass()
    values = mbdlft.random(model.parameters, 20, seed=2)
    found = mbdlft.poles(model, values)
    assert found.shape == (20, 2)
    for k in range(20):
        k_over_m = values["k"][k] / values["m"][k]
        half = 0.01 / values["m"][k]
        target(found[k, 0], -half + 1j * np.sqrt(k_over_m - half**2), CLOSED_FORM)
        alone = {name: float(column[k]) for name, column in values.items()}
        exact(mbdlft.poles(model, alone)[0], found[k])
    exact(mbdlft.damping_table(model, values).poles, found)


def test_gradients_are_those_of_the_closed_form() -> None:
    """p = -c/2m + j sqrt(k/m - (c/2m)^2), by normalized k and m at a point off nominal."""
    model = spring_and_mass()
    at = {"k": 5.0, "m": 1.2}
    found = mbdlft.pole_gradients(model, at)
    half, root = 0.01 / 1.2, np.sqrt(5.0 / 1.2 - (0.01 / 1.2) ** 2)
    target(found.poles, [-half + 1j * root, -half - 1j * root], CLOSED_FORM)
    by_k = 1j / (2.0 * root * 1.2)
    by_m = half / 1.2 + 1j * (-5.0 / 1.2**2 + 2.0 * half**2 / 1.2) / (2.0 * root)
    for column, (name, derivative) in enumerate({"k": by_k, "m": by_m}.items()):
        parameter = model.parameters[name]
        delta = float(mbdlft.to_delta(parameter, at[name]))
        step = np.array([delta - 1e-5, delta + 1e-5])
        slope = float(np.diff(mbdlft.to_physical(parameter, step))[0] / 2e-5)
        finite_difference(found.gradients[0, column], derivative * slope, scale=abs(by_k))
        finite_difference(found.gradients[1, column], np.conj(derivative) * slope, scale=abs(by_k))


def test_gradients_of_the_arm_are_differences() -> None:
    """Repeated parameters, D_zw that is not zero, a point that is not nominal."""
    arm = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
    at = {"m1": 3.3, "theta1": 60.0, "L2": 0.9, "rho1": 0.31}
    found = mbdlft.pole_gradients(arm, at)
    h = 1e-6
    for k, parameter in enumerate(arm.parameters):
        delta = float(mbdlft.to_delta(parameter, at.get(parameter.name, parameter.nominal)))
        moved = {**at, parameter.name: mbdlft.to_physical(parameter, [delta - h, delta + h])}
        below, above = mbdlft.poles(arm, moved)
        finite_difference(found.gradients[:, k], (above - below) / (2.0 * h), scale=1.0)


TURN = np.linalg.qr(np.random.default_rng(4).normal(size=(4, 4)))[0]
JORDAN = np.eye(4, k=1)


@pytest.mark.parametrize(
    ("A", "expected"),
    [
        (JORDAN - np.eye(4), "stable"),  # defective, and far from the axis
        (TURN @ (JORDAN - np.eye(4)) @ TURN.T, "stable"),
        (TURN @ (JORDAN + np.eye(4)) @ TURN.T, "unstable"),
        ([[0.0, 1.0], [0.0, 0.0]], "marginal"),
        (TURN @ np.diag([0.0, -1.0, -2.0, -3.0]) @ TURN.T, "marginal"),
        (TURN @ np.kron(np.eye(2), [[0.0, 1.0], [0.0, 0.0]]) @ TURN.T, "marginal"),
        (TURN @ np.kron(np.diag([1.0, 7.0]), [[0.0, 1.0], [-1.0, 0.0]]) @ TURN.T, "marginal"),
        ([[0.0, 1.0], [-1.0, -1e-9]], "stable"),
        ([[0.0, 1.0], [-1.0, 1e-9]], "unstable"),
        (np.diag([1e-6, -1e6]), "unstable"),
        (np.diag([-1e-6, -1e6]), "stable"),
    ],
)
def test_side_of_the_axis_is_told_where_rounding_lets_it(A: object, expected: str) -> None:
    assert spectrum(np.array(A)).stability == expected


def test_integrators_are_at_zero_and_slow_undamped_modes_are_not() -> None:
    free = TURN @ np.kron(np.eye(2), [[0.0, 1.0], [0.0, 0.0]]) @ TURN.T
    found = spectrum(free)
    assert np.all(found.at_zero)
    exact(found.cleaned, np.zeros(4))
    slow = spectrum(np.array([[0, 1, 0, 0], [-1e-12, 0, 0, 0], [0, 0, 0, 1.0], [0, 0, -1, 0]]))
    assert np.all(slow.on_axis)
    assert not np.any(slow.at_zero)
    target(np.abs(slow.poles), [1e-6, 1e-6, 1.0, 1.0], CLOSED_FORM)


def test_free_masses_are_marginal_and_have_one_mode() -> None:
    masses = two_masses([2.0, 3.0], 50.0, 0.1)
    rows = mbdlft.damping_table(masses).rows()
    assert [row.on_axis for row in rows] == [True, True, False]
    omega = np.sqrt(50.0 * (1.0 / 2.0 + 1.0 / 3.0))
    target(rows[2].natural_frequency, omega, CLOSED_FORM)
    target(rows[2].damping, 0.1 / 50.0 * omega / 2.0, CLOSED_FORM)
    verdict = mbdlft.check_stability(masses)
    assert (verdict.nominal, verdict.counterexample) == ("marginal", {})
    assert "marginal at nominal; on the axis: 0 rad/s" in str(verdict)


def test_stable_box_is_not_called_proved() -> None:
    verdict = mbdlft.check_stability(spring_and_mass(), samples=50)
    assert verdict.nominal == "stable"
    assert not verdict.counterexample
    assert verdict.proof == ""
    assert "which proves nothing between them" in str(verdict)
    # damping c/2m is least at the largest m, where the search ends
    target(verdict.worst_pole.real, -0.01 / 1.5, CLOSED_FORM)
    target(verdict.worst["m"], 1.5, CLOSED_FORM)


def test_a_proof_is_one_of_the_whole_box() -> None:
    verdict = mbdlft.check_stability(spring_and_mass(), samples=0, prove=5.0)
    assert "stable for all values in the ranges, and up to 1.0" in str(verdict)
    # unstable in a disc of a hundredth of the box that nothing was seen of, or too near to it
    for width in (0.02, 0.002):
        verdict = mbdlft.check_stability(narrow(width), samples=0, prove=1.0)
        assert verdict.nominal == "stable"
        assert verdict.proof == ""
    barely = mbdlft.realize([["a - 1"]], [mbdlft.Parameter("a", 0.0, -1.0, 1.0)], states=1, search=0.0)
    verdict = mbdlft.check_stability(barely, samples=0, prove=1.0)
    assert verdict.proof == ""
    assert "a pole is on the axis at a = 1" in str(verdict)


def narrow(width: float, *beside: str) -> mbdlft.LFTModel:
    """Unstable only near a = 0.6, b = -0.7: inside of the box, off its corners; and other poles."""
    bump = f"1 - 1.05/(1 + ((a - 0.6)^2 + (b + 0.7)^2)/{width}^2)"
    diagonal, none = [f"-({bump})", *beside], ["0"] * len(beside)
    matrix = [[*none[:k], pole, *none[k:]] for k, pole in enumerate(diagonal)]
    own = [mbdlft.Parameter(name, 0.0, -1.0, 1.0) for name in "ab"]
    return mbdlft.realize(matrix, own, states=len(matrix), search=0.0)


@pytest.mark.parametrize("beside", [(), ("-0.001",)], ids=["alone", "beside a pole that nothing moves"])
def test_counterexample_inside_the_box_is_found_by_the_search_alone(beside: tuple[str, ...]) -> None:
    """No corner is unstable and no sample is tried; the gradient leads from nominal to it."""
    verdict = mbdlft.check_stability(narrow(0.5, *beside), samples=0)
    assert verdict.nominal == "stable"
    assert verdict.counterexample
    a, b = verdict.counterexample["a"], verdict.counterexample["b"]
    assert (a - 0.6) ** 2 + (b + 0.7) ** 2 < 0.05 * 0.5**2
    assert mbdlft.poles(narrow(0.5), verdict.counterexample)[0, 0].real > 0.0
    assert "stable at nominal, unstable in the range" in str(verdict)


def test_unstable_nominal_names_the_pole() -> None:
    arm = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
    verdict = mbdlft.check_stability(arm, samples=10)
    assert verdict.nominal == "unstable"
    assert "unstable at nominal: pole 3.1048 rad/s" in str(verdict)
    sampled = mbdlft.poles(arm, mbdlft.random(arm.parameters, 2000, seed=8))
    assert verdict.worst_pole.real >= np.max(sampled.real)


def test_system_without_states_or_parameters() -> None:
    static = plain(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[2.0]])
    assert mbdlft.poles(static).shape == (1, 0)
    assert mbdlft.damping_table(static).rows() == ()
    assert "no states" in str(mbdlft.check_stability(static))
    assert mbdlft.check_stability(oscillator(0.1)).points == 1


# Transmission zeros against closed forms, python-control, and 50 digits -----------------------------


def test_two_masses_have_the_zeros_of_the_clamped_ones() -> None:
    """Where the force acts: m2 s^2 + c s + k = 0. At the other mass: c s + k = 0. At both: none."""
    m, k, c = [2.0, 3.0], 1e6, 0.1
    masses = two_masses(m, k, c)
    (first,) = mbdlft.zeros(masses, outputs="y0", inputs="u0")
    expected = -c / 6.0 + 1j * np.sqrt(k / 3.0 - (c / 6.0) ** 2)
    target(first, [expected, np.conj(expected)], CLOSED_FORM)
    (other,) = mbdlft.zeros(masses, outputs=["y1"])
    target(other, [-k / c], ZEROS)
    assert mbdlft.zeros(masses)[0].size == 0


@pytest.mark.parametrize("scale", [1.0, 1e6, 1e-6])
@pytest.mark.parametrize("direct", [False, True])
def test_random_square_systems_against_python_control(scale: float, direct: bool) -> None:
    for seed in range(6):
        system = random_system(seed, 7, 2, 2, direct=direct)
        A, B, C, D = matrices(system)
        expected = np.sort_complex(control.ss(A, B, C, D).zeros())
        units = np.array([scale, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0 / scale])
        other = plain(A * units[:, None] / units, B * units[:, None] * scale, C / units, D * scale)
        assert len(expected) == (7 if direct else 5)
        found = mbdlft.zeros(other)[0]
        apart = np.abs(found[:, None] - expected)
        target(found[np.argmin(apart, axis=0)], expected, ZEROS)
        assert len(set(np.argmin(apart, axis=0))) == len(found) == len(expected)


def test_wide_systems_have_the_zeros_that_were_put_in() -> None:
    """Behind a filter with a zero, in all its inputs, every transfer has that zero."""
    system = random_system(1, 5, 2, 3)
    assert mbdlft.zeros(system)[0].size == 0
    filtered = mbdlft.series(control.tf([1.0, -3.0], [1.0, 4.0]) * np.eye(1), random_system(2, 4, 2, 1))
    found = mbdlft.zeros(filtered)[0]
    assert found.size == 1
    target(found, [3.0], ZEROS)


def test_hidden_modes_are_no_zeros() -> None:
    """A mode that the input does not reach, one that the output does not see, and a zero at -5."""
    A = np.diag([-1.0, -2.0, -3.0, -4.0])
    hidden = plain(A, [[1.0], [0.0], [1.0], [1.0]], [[2.0, 1.0, 0.0, -1.0]])
    (found,) = mbdlft.zeros(hidden)  # 2/(s+1) - 1/(s+4) = (s + 7)/((s+1)(s+4))
    target(found, [-7.0], CLOSED_FORM)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]
    B, C = matrices(hidden)[1:3]
    target(mbdlft.zeros(plain(turn @ A @ turn.T, turn @ B, C @ turn.T))[0], [-7.0], ZEROS)


def test_a_mode_that_no_entries_lead_to_is_no_zero() -> None:
    """The others are reached so badly that rounding of the staircase reaches it, too."""
    A = np.diag([-2.57, -3.47, -1.48, -2.16, -2.43, -2.09])
    A[0, 1], A[1, 0], A[3:, 2], A[3, [1, 4, 5]] = 0.34, 0.09, [0.88, 0.43, 0.09], [-1.13, 0.75, 3.06]
    A[4, 5] = 0.04
    b, c = np.array([-0.99, 2.7, 0.0, -0.5, -3.12, -1.18]), np.array([0.0, 0.0, 0.0, 0.0, 0.28, 1.8])
    top, bottom = c[4:] * b[4:]
    zero = (top * A[5, 5] + bottom * A[4, 4] - c[4] * A[4, 5] * b[5]) / (top + bottom)
    target(mbdlft.zeros(plain(A, b[:, None], c[None]))[0], [zero], CLOSED_FORM)


def test_zeros_are_where_the_pencil_loses_rank_in_50_digits() -> None:
    model = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
    values = mbdlft.corners(model.parameters)
    some = {name: column[::17] for name, column in values.items()}
    found = mbdlft.zeros(model, some, outputs="shoulder.angle", inputs="shoulder.torque")
    A, B, C, _ = mbdlft.matrices_at(model, some)
    assert len(found) == 8
    with mp.workdps(50):
        for k, row in enumerate(found):
            assert len(row) == 2
            for zero in row:
                target(complex(_refined(A[k], B[k, :, :1], C[k, :1], complex(zero))), zero, ZEROS)


def _refined(A: np.ndarray, B: np.ndarray, C: np.ndarray, start: complex) -> mp.mpc:
    """Root of det [A - s, B; C, 0] near a start."""

    def determinant(s: mp.mpc) -> mp.mpc:
        top = np.hstack([A, B]).tolist()
        pencil = mp.matrix([*top, [*C[0].tolist(), 0.0]])
        for i in range(len(A)):
            pencil[i, i] -= s
        return mp.det(pencil)

    return mp.findroot(determinant, (start * (1 + 1e-6), start), solver="secant")


def test_systems_without_zeros() -> None:
    assert mbdlft.zeros(oscillator(0.1))[0].size == 0
    nothing: mbdlft.System = plain([[-1.0]], [[0.0]], [[1.0]])
    assert mbdlft.zeros(nothing)[0].size == 0


@pytest.mark.parametrize("coupling", ["1e-14", "3e-14"])
def test_poles_where_the_iteration_of_lapack_has_no_end(coupling: str) -> None:
    """Two oscillators that a gyroscopic stiffness couples: K = [[k, e], [-e, k]]."""
    rows = f"0 0 1 0 0; 0 0 0 1 0; -k -{coupling} 0 0 1; {coupling} -k 0 0 0; 1 0 0 0 0"
    k = mbdlft.Parameter("k", 1.0, percent=20)
    model = mbdlft.realize(kit.rows(rows), [k], states=4, search=0.0)
    A = mbdlft.matrices_at(model, {})[0]
    values, left, right = eigenvectors_of(A)
    roundoff(np.abs(values), np.ones(4))
    roundoff(np.abs(eigenvalues_of(A)), np.ones(4))
    roundoff(A @ right, right * values)
    roundoff(np.conj(left.T) @ A, values[:, None] * np.conj(left.T))
    roundoff(np.abs(mbdlft.poles(model)), np.ones((1, 4)))


# Poles beside the axis: damped if the matrix says so; norms against 60 digits where damping is 1e-9.


@pytest.mark.parametrize("seed", range(6))
def test_norms_of_free_flyers_against_60_digits(seed: int) -> None:
    """Eight channels each: finite where no pole on the axis is seen, and right to 1e-6."""
    system = free_flyer(seed)
    poles = spectrum(samples_at(system).A[0]).poles
    for (y, u), is_finite in FINITE.items():
        found = hinf_norm(system, outputs=y, inputs=u)
        assert np.isfinite(found.lower[0]) == is_finite, (y, u, found.reason)
        if is_finite:
            expected = peak_of_60_digits(seed, y, u, poles)
            target(found.lower[0], expected, NORM)
            assert found.upper[0] >= expected * (1.0 - 1e-9)


@pytest.mark.parametrize("fastest", [0.0, 1e5])
@pytest.mark.parametrize("seed", range(3))
def test_a_damped_nutation_is_nowhere_on_the_axis(seed: int, fastest: float) -> None:
    """Spectrum, table, verdict: a pair whose damping is below 1e-6, beside a mode of 1e5 rad/s, too."""
    system = free_flyer(seed, fastest)
    seen = spectrum(samples_at(system).A[0])
    nutation = int(np.argmin(np.where(seen.at_zero, np.inf, np.abs(seen.poles))))
    assert 0.0 < -seen.poles[nutation].real < 1e-6 * abs(seen.poles[nutation])
    assert not seen.on_axis[nutation]
    assert np.array_equal(seen.on_axis, seen.at_zero)
    rows = mbdlft.damping_table(system).rows()
    assert [row.on_axis for row in rows if row.natural_frequency > 0.0] == [False] * sum(
        row.natural_frequency > 0.0 for row in rows
    )
    verdict = mbdlft.check_stability(system)
    assert verdict.nominal == "marginal"
    assert "on the axis: 0 rad/s" in verdict.sentence


@pytest.mark.parametrize("n", [2, 5, 9])
def test_an_eigenpair_in_balls_has_that_of_all_matrices_so_near(n: int) -> None:
    """Matrices at the ends of rounding have their eigenvalue in the ball; double ones have no ball."""
    random = np.random.default_rng(n)
    A = random.standard_normal((n, n))
    values, V = np.linalg.eig(A)
    k = int(np.argmax(values.real))
    pair = eigenpair(A, complex(values[k]), V[:, k])
    assert pair is not None
    ends = A * (1.0 + 15.0 * 2.0**-52 * np.sign(random.standard_normal((n, n))))
    near = eigenpair(ends, complex(values[k]), V[:, k])
    assert near is not None
    assert pair[-1].contains(near[-1].mid())
    assert float(pair[-1].real.rad()) <= 1e-9
    jordan = np.diag(np.ones(n - 1), 1)
    assert eigenpair(jordan, 0j, np.eye(n)[0]) is None


def undamped(stiffness: np.ndarray) -> np.ndarray:
    nothing, one = np.zeros_like(stiffness), np.eye(len(stiffness))
    return np.block([[nothing, one], [-stiffness, nothing]])


def test_balls_are_asked_only_where_zeros_of_the_matrix_do_not_decide(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Undamped chains, three of them equal; a slow saddle beside a fast mode is none on the axis."""
    asked = []

    def counted(*arguments):
        asked.append(arguments)
        return eigenpair(*arguments)

    monkeypatch.setattr("mbdlft.response.modes.eigenpair", counted)
    chain = 2.0 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
    alike = np.kron(np.eye(3), chain) + 0.01 * np.kron(np.ones((3, 3)), np.eye(4))
    assert np.all(spectrum(undamped(alike)).on_axis)
    assert not asked
    saddle = spectrum(undamped(np.array([[-1e-4, 1e-3], [1e-3, 1e10]])))
    assert asked
    assert np.array_equal(saddle.on_axis, saddle.poles.imag != 0.0)


# Linearizations, trims and responses in doubles are within a hundred roundings of many digits.


@pytest.mark.parametrize("name", ["two_link_arm", "four_bar", "gimbal"])
def test_linearizations_and_trims(name: str) -> None:
    problem = problem_of_scene(mbdlft.load_scene(f"scenarios/{name}.toml"))
    at, some = problem.reference(), [0, 1, -1]
    assert at.in_digits is not None
    assert at.trim_in_digits is not None
    rounding = EPS * np.maximum(at.scale, np.max(at.sizes(), axis=0))
    errors = np.abs(at.values[some] - at.in_digits(problem.points[some])) / rounding
    truth, scale = at.trim_in_digits()
    of_trim = np.abs(at.trimmed - truth) / (EPS * scale)
    assert ROOM * max(np.max(errors), np.max(of_trim)) <= MOST_ROUNDINGS


@pytest.mark.parametrize("seed", range(3))
def test_responses_over_time(seed: int) -> None:
    """exp of [A B ; 0 0] in 40 digits: a step; it is within roundings of what exp(|A| t) would add up."""
    system = random_system(seed, 4, 2, 2, direct=True)
    A, B, C, D = (np.asarray(x) for x in (system.A, system.B_u, system.C_y, system.D_yu))
    times = np.linspace(0.0, 3.0, 25)
    found = mbdlft.step_response(system, times=times).values[0]
    bordered = np.block([[A, B], [np.zeros((2, 6))]])
    read = np.hstack([C, D])
    with mpmath.workdps(40):
        for t, values in zip(times[[0, 7, 24]].tolist(), found[[0, 7, 24]], strict=True):
            whole = mpmath.expm(mpmath.matrix(bordered.tolist()) * t)
            expected = (mpmath.matrix(read.tolist()) * whole[:, 4:]).tolist()
            error = np.max(np.abs(values - np.array(expected, dtype=float)))

            assert ROOM * error <= MOST_ROUNDINGS * EPS * np.max(np.abs(found))


def test_the_trim_in_digits_has_them_whoever_asks_first() -> None:
    """Two weights on a beam at 45 deg that nearly balance: seven of 16 digits cancel."""
    turned = kit.turn((0, 1, 0), 0.7853981633974483)
    inertia = mbdlft.Inertia(xx=0.1, yy=0.1, zz=0.1)
    arms = {"left": 0.7, "right": -0.7000001}
    scene = kit.scene(
        "scales",
        kit.body("beam", 0.2, inertia=inertia),
        *(kit.body(name, 1.3, center_of_mass=(x, 0, 0), inertia=inertia) for name, x in arms.items()),
        kit.hinge("pin", "ground", "beam", (0, 1, 0)),
        *(kit.weld(f"{name} weld", "beam", name, orientation=[turned]) for name in arms),
        gravity=(0.0, 0.0, -9.81),
    )
    in_digits = problem_of_scene(scene).reference().trim_in_digits
    assert in_digits is not None
    truth, _ = in_digits()
    torque = float(-Fraction("1.3") * Fraction("9.81") * Fraction("-0.0000001")) * np.sqrt(0.5)
    assert abs(abs(truth[0, 0]) - torque) <= 2.0 * EPS * torque
