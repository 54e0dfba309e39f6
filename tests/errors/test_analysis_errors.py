"""Errors of poles, zeros, norms, responses and their figures: class and message."""

import numpy as np
import pytest

import mbdlft
from mbdlft import AnalysisError, check_stability, frequency_response, h2_norm, hinf_norm, poles, zeros
from mbdlft.lft.lft import LFT, Block
from mbdlft.response import modes, norms, staircase
from mbdlft.robust import stability
from mbdlft.robust.ascent import push_right
from mbdlft.robust.realization import realization
from mbdlft.show import save_bode, save_pole_map, save_singular_values, save_step
from tests.errors.table import refused, says
from tests.oscillators import oscillator, plain, random_system, spring_and_mass


@pytest.fixture(scope="module")
def model():
    return spring_and_mass()


def _ill_posed(p):
    """xdot = -x/p: singular where p is zero, in the middle of its range."""
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


ILL = _ill_posed(mbdlft.Parameter("p", 0.5, -1.0, 1.0))
DEAF = plain([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0)))
MUTE = plain([[-1.0]], [[1.0]], np.zeros((0, 1)), np.zeros((0, 1)))
STATIC = plain(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[2.0]])

test_messages = refused(
    r"""
> {} => AnalysisError:
{zeros|hinf_norm|h2_norm|step_response|impulse_response}(model, outputs='place')
    => model 'spring': unknown output 'place'. Existing: position.
{zeros|hinf_norm|h2_norm|step_response|impulse_response}(model, inputs=['force', 'forse'])
    => unknown input 'forse'. Did you mean 'force'? Existing: force.
{zeros|hinf_norm|h2_norm|step_response|impulse_response}(model, inputs=[])
    => model 'spring': without inputs there are no
{zeros|hinf_norm|h2_norm|step_response|impulse_response}(DEAF)
    => model 'plain': without inputs there are no … Choose some
{zeros|hinf_norm|h2_norm|step_response|impulse_response}(MUTE)
    => model 'plain': without outputs there are no … Choose some
frequency_response(spring_and_mass('0'), {'k': [3.0, 4.0], 'm': 1.0}, [1.0, 2.0])
    => model 'spring': omega = 2 rad/s is a pole at one of the samples
step_response(plain([[1.0]], [[1.0]], [[1.0]]), {}, [0.0, 1000000.0])
    => the response grows beyond the largest number before 1e+06 s.
step_response(mbdlft.state_space([[1j]], [[1.0]], [[1.0]], [[0.0]], name='turning'))
    => model 'turning': responses in time are those of real matrices
> hinf_norm(model, tolerance={}) => AnalysisError: expected a tolerance from 1e-10 to 1,
{0.0|1.0|-1.0|1e-12} => got {0}.
np.nan => got nan.
> response_frequencies(model, dict(), **dict.fromkeys(["low"], {})) => AnalysisError: expected a positive
    finite low end (rad/s), got
0.0 => 0.0.
-1.0 => -1.0.
np.inf => inf.
np.nan => nan.
True => True.
> response_frequencies(model, dict(), **dict.fromkeys(["high"], {})) => AnalysisError: expected a positive
    finite high end (rad/s), got
0.0 => 0.0.
-1.0 => -1.0.
np.inf => inf.
np.nan => nan.
True => True.
> {step_response|impulse_response}(model, dict(), {}) => AnalysisError: times: expected rising finite
    times (s), the first not negative
[0.0, 0.0]
[1.0, 0.5]
[-1.0, 0.0]
[0.0, np.inf]
["soon"]
[]
[[0.0, 1.0]]
> {} => AnalysisError:
response_frequencies(model, {}, 3.0, 2.0)
    => frequencies: expected low < high, got 3 and 2 rad/s.
response_frequencies(model, {}, points={1|2.5}) => expected at least 2 points of frequency, got {0}.
frequency_response(model, {}, np.ones((2, 3)))
    => omega: expected frequencies (F,), or a row (N, F) for each of 1 samples, got shape (2, 3).
initial_response(model, {"speed": 1.0}) => unknown state 'speed'. Existing: x0, x1.
initial_response(model, {model.states[0].name: np.inf}) => expected a finite number, got inf.
initial_response(model, {model.states[0].name: "fast"}) => expected a finite number, got 'fast'.
initial_response(model, {model.states[0].name: None}) => expected a finite number, got None.
check_stability(model, {-1|2.5}) => expected a number of samples such as 300, got {0}.
check_stability(model, "many") => expected a number of samples such as 300, got 'many'.
pole_gradients(model, {"k": [4.0, 5.0]}) => pole_gradients takes one number for each parameter.
damping_table(model).rows(3) => there is no sample 3 in a table of 1.
save_pole_map(tmp_path / "f.png", model, "K")
    => model 'spring': unknown parameter 'K'. Did you mean 'k'?
save_pole_map(tmp_path / "f.png", STATIC) => model 'plain': without states there are no poles to draw.
save_bode(tmp_path / "f.png", random_system(0, 6, 6, 6))
    => 6 x 6 channels are more than the 16 that a figure has room for.
save_step(tmp_path / "f.png", random_system(0, 6, 6, 6))
    => 6 x 6 channels are more than the 25 that a figure has room for.
{save_bode|save_step}(tmp_path / "f.png", DEAF) => without inputs there are no channels to draw.
{save_bode|save_step}(tmp_path / "f.abc", model)
    => f.abc: the figure cannot be written: expected the ending
> {poles|damping_table|zeros|hinf_norm|h2_norm|step_response|impulse_response|response_frequencies|
    unbounded_frequencies}(model, {}) => StructureError:
{"K": 4.0} => model 'spring': unknown parameter 'K'. Did you mean 'k'?
{"k": 7.0} => model 'spring': k = 7 is outside its range [3, 6] N/m.
{"k": [4.0, np.nan]} => k = nan is outside its range
> {} => WellPosednessError: model 'ill': it is singular …
{poles|damping_table|zeros|hinf_norm|h2_norm|step_response|impulse_response}(ILL, {"p": 0.0}) => p = 0
{response_frequencies|unbounded_frequencies}(ILL, {"p": 0.0}) => p = 0
pole_gradients(ILL, {"p": 0.0})
"""
)


def test_frequency_of_a_pole_but_for_its_last_digits():
    for stiffness in (2.0, 3.0, 5.0, 7.0, 11.0, 13.0):
        ringing = plain([[0.0, 1.0], [-stiffness, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]])
        with says(AnalysisError, "rad/s is a pole at one of the samples"):
            frequency_response(ringing, {}, [np.sqrt(stiffness)])


def test_norm_whose_two_ways_differ(model, monkeypatch):
    monkeypatch.setattr(norms, "_h2", lambda plant: (1.0, 0.01, ""))
    with says(AnalysisError, "h2_norm: two ways to compute it differ by 1.0e-02", "Add damping."):
        h2_norm(model)


def test_norm_that_is_not_found_says_so(model, monkeypatch):
    monkeypatch.setattr(norms, "_ROUNDS", 0)
    found = hinf_norm(model)
    assert found.upper[0] == np.inf
    assert found.reason == ("no level without eigenvalues on the axis in 0 rounds",)


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
    delta, pole, used = push_right(realization(ILL), np.array([0.5]), -1.0, 40)
    assert used <= 40
    assert np.all(np.abs(delta) <= 1.0)
    assert np.isfinite(pole.real)
    monkeypatch.setattr(stability, "_CORNERS", 2)
    assert check_stability(ILL, samples=5).counterexample["p"] < 0.0


def test_figures_without_parameters_or_damping_are_drawn(tmp_path):
    file = tmp_path / "f.png"
    for save in (save_singular_values, save_bode, save_step, save_pole_map):
        save(file, oscillator(0.0))
        assert file.read_bytes().startswith(b"\x89PNG")
        file.unlink()
        save(file, STATIC) if save is not save_pole_map else None
