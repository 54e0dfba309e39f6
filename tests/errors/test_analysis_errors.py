"""Errors of poles, zeros, norms, responses and their figures: class and message."""

import numpy as np
import pytest

import mbdlft
from mbdlft import (
    AnalysisError,
    StructureError,
    WellPosednessError,
    check_stability,
    damping_table,
    frequency_response,
    h2_norm,
    hinf_norm,
    impulse_response,
    initial_response,
    pole_gradients,
    poles,
    response_frequencies,
    step_response,
    unbounded_frequencies,
    zeros,
)
from mbdlft.response import modes, norms, staircase
from mbdlft.robust import stability
from mbdlft.robust.ascent import push_right
from mbdlft.robust.realization import realization
from mbdlft.show import save_bode, save_pole_map, save_singular_values, save_step
from tests.errors.table import refused, says
from tests.oscillators import oscillator, plain, random_system, spring_and_mass

ASKS = (
    poles,
    damping_table,
    zeros,
    hinf_norm,
    h2_norm,
    step_response,
    impulse_response,
    response_frequencies,
    unbounded_frequencies,
)


@pytest.fixture(scope="module")
def model():
    return spring_and_mass()


@pytest.mark.parametrize("ask", ASKS)
def test_values_that_do_not_fit(model, ask):
    with says(StructureError, "model 'spring': unknown parameter 'K'. Did you mean 'k'?"):
        ask(model, {"K": 4.0})
    with says(StructureError, "model 'spring': k = 7 is outside its range [3, 6] N/m."):
        ask(model, {"k": 7.0})
    with says(StructureError, "k = nan is outside its range"):
        ask(model, {"k": [4.0, np.nan]})


@pytest.mark.filterwarnings("ignore:.*not proved.*:mbdlft.MbdlftWarning")
def test_singular_points():
    p = mbdlft.Parameter("p", 0.5, -1.0, 1.0)
    singular = mbdlft.state_space([[-1.0]], [[1.0]], [[1.0]], [[0.0]], name="s")
    gain = mbdlft.as_system(np.eye(1) + 0.0 * np.eye(1), name="unit", inputs=["a"], outputs=["b"])
    assert gain.order == 0
    loop = _ill_posed(p)
    for ask in ASKS:
        with says(WellPosednessError, "model 'ill': it is singular", "p = 0"):
            ask(loop, {"p": 0.0})
    with says(WellPosednessError, "model 'ill': it is singular"):
        pole_gradients(loop, {"p": 0.0})
    assert singular.order == 0


def _ill_posed(p):
    """xdot = -x/p: singular where p is zero, in the middle of its range."""
    from mbdlft.lft.lft import LFT, Block

    to = p.map
    # 1/p = 1/(b0 + gain d) = (1/b0)/(1 + (gain/b0) d)
    assert to.a1 != 0.0
    ratio = to.b1 / to.b0
    M11, M12 = [[-ratio]], [[1.0, 0.0]]
    M21 = [[ratio / to.b0], [0.0]]
    M22 = [[-1.0 / to.b0, 1.0], [1.0, 0.0]]
    lft = LFT(np.array(M11), np.array(M12), np.array(M21), np.array(M22), (Block("p", 1),))
    return mbdlft.System(
        "ill", lft, (mbdlft.Signal("x", "1"),), (mbdlft.Signal("u", "1"),),
        (mbdlft.Signal("y", "1"),), (p,),
    )  # fmt: skip


test_messages = refused(
    r"""
> {} => AnalysisError:
zeros(model, outputs='place') => model 'spring': unknown output 'place'. Existing: position.
zeros(model, inputs=['force', 'forse']) => unknown input 'forse'. Did you mean 'force'? Existing: force.
zeros(model, inputs=[]) => model 'spring': without inputs there are no
zeros(plain([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0))))
    => model 'plain': without inputs there are no … Choose some
zeros(plain([[-1.0]], [[1.0]], np.zeros((0, 1)), np.zeros((0, 1))))
    => model 'plain': without outputs there are no … Choose some
hinf_norm(model, outputs='place') => model 'spring': unknown output 'place'. Existing: position.
hinf_norm(model, inputs=['force', 'forse'])
    => unknown input 'forse'. Did you mean 'force'? Existing: force.
hinf_norm(model, inputs=[]) => model 'spring': without inputs there are no
hinf_norm(plain([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0))))
    => model 'plain': without inputs there are no … Choose some
hinf_norm(plain([[-1.0]], [[1.0]], np.zeros((0, 1)), np.zeros((0, 1))))
    => model 'plain': without outputs there are no … Choose some
h2_norm(model, outputs='place') => model 'spring': unknown output 'place'. Existing: position.
h2_norm(model, inputs=['force', 'forse'])
    => unknown input 'forse'. Did you mean 'force'? Existing: force.
h2_norm(model, inputs=[]) => model 'spring': without inputs there are no
h2_norm(plain([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0))))
    => model 'plain': without inputs there are no … Choose some
h2_norm(plain([[-1.0]], [[1.0]], np.zeros((0, 1)), np.zeros((0, 1))))
    => model 'plain': without outputs there are no … Choose some
step_response(model, outputs='place') => model 'spring': unknown output 'place'. Existing: position.
step_response(model, inputs=['force', 'forse'])
    => unknown input 'forse'. Did you mean 'force'? Existing: force.
step_response(model, inputs=[]) => model 'spring': without inputs there are no
step_response(plain([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0))))
    => model 'plain': without inputs there are no … Choose some
step_response(plain([[-1.0]], [[1.0]], np.zeros((0, 1)), np.zeros((0, 1))))
    => model 'plain': without outputs there are no … Choose some
impulse_response(model, outputs='place') => model 'spring': unknown output 'place'. Existing: position.
impulse_response(model, inputs=['force', 'forse'])
    => unknown input 'forse'. Did you mean 'force'? Existing: force.
impulse_response(model, inputs=[]) => model 'spring': without inputs there are no
impulse_response(plain([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0))))
    => model 'plain': without inputs there are no … Choose some
impulse_response(plain([[-1.0]], [[1.0]], np.zeros((0, 1)), np.zeros((0, 1))))
    => model 'plain': without outputs there are no … Choose some
response_frequencies(model, {}, low=0.0) => expected a positive finite low end (rad/s), got 0.0.
response_frequencies(model, {}, high=0.0) => expected a positive finite high end (rad/s), got 0.0.
response_frequencies(model, {}, low=-1.0) => expected a positive finite low end (rad/s), got -1.0.
response_frequencies(model, {}, high=-1.0) => expected a positive finite high end (rad/s), got -1.0.
response_frequencies(model, {}, low=np.inf) => expected a positive finite low end (rad/s), got inf.
response_frequencies(model, {}, high=np.inf) => expected a positive finite high end (rad/s), got inf.
response_frequencies(model, {}, low=np.nan) => expected a positive finite low end (rad/s), got nan.
response_frequencies(model, {}, high=np.nan) => expected a positive finite high end (rad/s), got nan.
response_frequencies(model, {}, low=True) => expected a positive finite low end (rad/s), got True.
response_frequencies(model, {}, high=True) => expected a positive finite high end (rad/s), got True.
frequency_response(spring_and_mass('0'), {'k': [3.0, 4.0], 'm': 1.0}, [1.0, 2.0])
    => model 'spring': omega = 2 rad/s is a pole at one of the samples
step_response(plain([[1.0]], [[1.0]], [[1.0]]), {}, [0.0, 1000000.0])
    => the response grows beyond the largest number before 1e+06 s.
step_response(mbdlft.state_space([[1j]], [[1.0]], [[1.0]], [[0.0]], name='turning'))
    => model 'turning': responses in time are those of real matrices
> hinf_norm(model, tolerance={}) => AnalysisError: expected a tolerance from 1e-10 to 1,
0.0 => got 0.0.
1.0 => got 1.0.
-1.0 => got -1.0.
1e-12 => got 1e-12.
np.nan => got nan.
"""
)


def test_frequencies_that_do_not_rise(model):
    with says(AnalysisError, "frequencies: expected low < high, got 3 and 2 rad/s."):
        response_frequencies(model, {}, 3.0, 2.0)
    for points in (1, 2.5):
        with says(AnalysisError, f"expected at least 2 points of frequency, got {points!r}."):
            response_frequencies(model, {}, points=points)
    with says(
        AnalysisError,
        "omega: expected frequencies (F,), or a row (N, F) for each of 1 samples, got shape (2, 3).",
    ):
        frequency_response(model, {}, np.ones((2, 3)))


def test_frequency_of_a_pole_but_for_its_last_digits():
    for stiffness in (2.0, 3.0, 5.0, 7.0, 11.0, 13.0):
        ringing = plain([[0.0, 1.0], [-stiffness, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]])
        with says(AnalysisError, "rad/s is a pole at one of the samples"):
            frequency_response(ringing, {}, [np.sqrt(stiffness)])


@pytest.mark.parametrize(
    "times", [[0.0, 0.0], [1.0, 0.5], [-1.0, 0.0], [0.0, np.inf], ["soon"], [], [[0.0, 1.0]]]
)
def test_times_that_do_not_rise(model, times):
    for ask in (step_response, impulse_response):
        with says(AnalysisError, "times: expected rising finite times (s), the first not negative"):
            ask(model, {}, times)


def test_initial_states(model):
    names = ", ".join(sorted(signal.name for signal in model.states))
    with says(AnalysisError, f"unknown state 'speed'. Existing: {names}."):
        initial_response(model, {"speed": 1.0})
    for value in (np.inf, "fast", None):
        with says(AnalysisError, f"expected a finite number, got {value!r}."):
            initial_response(model, {model.states[0].name: value})


def test_norm_whose_two_ways_differ(model, monkeypatch):
    monkeypatch.setattr(norms, "_h2", lambda plant: (1.0, 0.01, ""))
    with says(AnalysisError, "h2_norm: two ways to compute it differ by 1.0e-02", "Add damping."):
        h2_norm(model)


def test_norm_that_is_not_found_says_so(model, monkeypatch):
    monkeypatch.setattr(norms, "_ROUNDS", 0)
    found = hinf_norm(model)
    assert found.upper[0] == np.inf
    assert found.reason == ("no level without eigenvalues on the axis in 0 rounds",)


def test_samples_that_are_no_number(model):
    for samples in (-1, 2.5, "many"):
        with says(AnalysisError, f"expected a number of samples such as 300, got {samples!r}."):
            check_stability(model, samples)
    with says(AnalysisError, "pole_gradients takes one number for each parameter."):
        pole_gradients(model, {"k": [4.0, 5.0]})
    with says(AnalysisError, "there is no sample 3 in a table of 1."):
        damping_table(model).rows(3)


def test_eigenvalues_that_are_not_found(model, monkeypatch):
    def fails(*_):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(modes.np.linalg, "eigvals", fails)
    with says(AnalysisError, "model 'spring': the eigenvalues of A were not found."):
        poles(model)
    monkeypatch.setattr(staircase, "finite_zeros", fails)
    with says(AnalysisError, "zeros: the eigenvalues of a reduced pencil were not found."):
        zeros(model)


def test_search_that_meets_a_singular_point_goes_on(monkeypatch):
    """Towards p = 0 the pole -1/p runs away to the left, and beyond to the right."""
    loop = _ill_posed(mbdlft.Parameter("p", 0.5, -1.0, 1.0))
    delta, pole, used = push_right(realization(loop), np.array([0.5]), -1.0, 40)
    assert used <= 40
    assert np.all(np.abs(delta) <= 1.0)
    assert np.isfinite(pole.real)
    monkeypatch.setattr(stability, "_CORNERS", 2)
    assert check_stability(loop, samples=5).counterexample["p"] < 0.0


def test_figures(model, tmp_path):
    file = tmp_path / "f.png"
    with says(AnalysisError, "model 'spring': unknown parameter 'K'. Did you mean 'k'?"):
        save_pole_map(file, model, "K")
    static = plain(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[2.0]])
    with says(AnalysisError, "model 'plain': without states there are no poles to draw."):
        save_pole_map(file, static)
    large = random_system(0, 6, 6, 6)
    with says(AnalysisError, "6 x 6 channels are more than the 16 that a figure has room for."):
        save_bode(file, large)
    with says(AnalysisError, "6 x 6 channels are more than the 25 that a figure has room for."):
        save_step(file, large)
    deaf = plain([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0)))
    for save in (save_bode, save_step):
        with says(AnalysisError, "without inputs there are no channels to draw."):
            save(file, deaf)
        with says(AnalysisError, "f.abc: the figure cannot be written: expected the ending"):
            save(tmp_path / "f.abc", model)
    assert not file.exists()
    for save in (save_singular_values, save_bode, save_step, save_pole_map):
        save(file, oscillator(0.0))  # no parameters, no damping: drawn
        assert file.read_bytes().startswith(b"\x89PNG")
        file.unlink()
        save(file, static) if save is not save_pole_map else None
