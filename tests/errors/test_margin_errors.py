"""What cannot be analyzed is said with the pole, the state, the signal or the parameter."""

import numpy as np

import mbdlft
from mbdlft.robust.bisect.characteristic import is_hurwitz
from tests.errors.table import refused
from tests.reference.robust_cases import of_matrices, static

K = mbdlft.Parameter("k", 2.0, low=1.0, high=3.0, unit="N/m")


def cart(damping: str = "1") -> mbdlft.LFTModel:
    matrix = [["0", "1", "0"], [f"-k*({damping})", f"-({damping})", "1"], ["1", "0", "0"]]
    return mbdlft.realize(matrix, [K], states=2, inputs=["force"], outputs=["position"], search=0.0)


FIXED = mbdlft.state_space([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
ALONE = mbdlft.realize([["-k"]], [K], states=1, inputs=[], outputs=[], search=0.0)
DRIFT = [["0", "1", "0"], ["-k", "-1", "0"], ["1", "0", "0"]]
DRIFTING = mbdlft.realize(DRIFT, [K], states=3, inputs=[], outputs=[], search=0.0)
test_messages = refused(
    r"""
> {} => AnalysisError:
{robust_stability(cart('-1'))|worst_case_gain(cart('-1'))|robust_performance(cart('-1'))}
    => is unstable, with the pole … rad/s, in which … x1
worst_case_gain(cart(), "torque") => StructureError: inputs of … unknown signal 'torque'
robust_performance(cart(), "force", "angle") => StructureError: outputs of … unknown signal 'angle'
robust_stability(cart(), fixed=["K"]) => StructureError: unknown block 'K'. Did you mean 'k'
structured_singular_value(cart(), 1.0, fixed=["K"]) => StructureError: unknown block 'K'
structured_singular_value(cart(), 1.0, fixed=["k"]) => expected a block that is not fixed
robust_stability(cart(), fixed=["k"]) => a block that is not fixed
robust_stability(cart(), fixed=["k"], rates=1.0) => expected rates or fixed blocks, got both
structured_singular_value(of_matrices(np.zeros((1, 1)), np.eye(1), np.eye(1), np.zeros((1, 1)),
    ComplexBlock('c', 1)), 0.0)
    => omega = 0 rad/s is a pole
structured_singular_value(cart(), [np.nan]) => frequencies: expected numbers
robust_stability(static([[1j]], ComplexBlock("c", 1))) => StructureError: needs real entries
worst_case_gain(state_space([[-1j - 1]], [[1]], [[1]], [[0]]))
    => expected real matrices; an entry is complex
robust_stability(DRIFTING) =~ on the imaginary axis, 0.*x2.*leave_out
robust_stability(DRIFTING, leave_out=["x0"]) => x0 cannot be left out: the state  … depends
robust_stability(DRIFTING, leave_out=["x9"]) => StructureError: unknown signal 'x9'
robust_stability(FIXED) => no parameter and no uncertain block
structured_singular_value(FIXED, [1.0]) => no parameter and no uncertain block
mbdlft.mu_bands(cart(), 1.0, 1.0) => expected 0 < low < high
robust_stability(cart(), rates={"K": 1.0}) => unknown parameter 'K'. Did you mean 'k'
robust_stability(cart("-1"), rates=1.0) => unstable
robust_stability(of_matrices(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), ComplexBlock("c", 1),
    Block("d", 1)), rates={"d": 1.0})
    => StructureError: c is a complex block
{worst_case_gain|robust_performance}(ALONE) => without inputs or outputs there is no gain
{worst_case_gain|robust_performance}(mbdlft.as_system(cart())[[], :])
    => without inputs or outputs there is no gain
> robust_stability(cart(), {}) => AnalysisError:
gap={0.0|1.0} => gap: expected a number between 0
work=-1.0 => work: expected a number between 0
largest=np.inf => largest: expected a number between 0
> worst_case_gain(cart(), rates={"k": {}}) => AnalysisError: rate of k: expected a bound in N/m per
    second, 0 for
{-1.0|np.nan|True|"1 N/m"}
"""
)


def test_a_gain_needs_nothing_uncertain() -> None:
    assert 1.0 <= mbdlft.worst_case_gain(FIXED).upper <= 1.01


def test_too_little_work_is_said() -> None:
    """What the norm proves takes no search, and is never nothing."""
    found = mbdlft.robust_stability(cart(), work=1e-6)
    assert 0.0 < found.lower <= mbdlft.robust_stability(cart()).upper
    assert mbdlft.verify(cart(), found) == ""
    assert "the work of 1e-06 units was used up" in found.reason
    for gain in (
        mbdlft.worst_case_gain(cart(), work=1e-6),
        mbdlft.worst_case_gain(cart(), progress=_interrupt),
    ):
        assert gain.lower <= gain.upper < np.inf
        assert mbdlft.verify(cart(), gain) == ""
    margin = mbdlft.robust_performance(cart(), progress=_interrupt)
    assert 0.0 < margin.lower <= mbdlft.robust_performance(cart()).upper
    assert mbdlft.verify(cart(), margin) == ""
    assert margin.reason == "it was interrupted"
    light = cart("0.1")  # a range of k for which the norm is 2
    gain = mbdlft.worst_case_gain(light, work=1e-6)
    assert not gain.proved
    assert mbdlft.verify(light, gain) == f"there is no proof: {gain.reason}"
    assert "the work of 1e-06 units was used up" in gain.reason


def test_blocks_that_are_fixed_have_a_ball_too() -> None:
    """A stays in its range, where the norm proves stability, and b grows by what is left."""
    own = [mbdlft.Parameter("a", 0.0, low=-0.5, high=0.5), mbdlft.Parameter("b", 0.0, low=-0.5, high=0.5)]
    decay = mbdlft.realize([["-1+a", "3"], ["b", "-1"]], own, states=2, inputs=[], outputs=[], search=0.0)
    found = mbdlft.robust_stability(decay, fixed=["a"], progress=_interrupt)  # (1 - a) > 3 b
    assert 0.05 < found.lower <= 1.0 / 3.0
    assert mbdlft.verify(decay, found) == ""


def _interrupt(lower: float, upper: float) -> None:
    raise KeyboardInterrupt


def test_too_many_repetitions_are_said() -> None:
    """Neither a polynomial nor full multipliers are carried; what was reached is returned."""
    random = np.random.default_rng(0)
    blocks = tuple(mbdlft.Block(f"d{k}", 10) for k in range(8))
    B, C = random.standard_normal((4, 80)), random.standard_normal((80, 4))
    system = of_matrices(-10.0 * np.eye(4), 0.01 * B, C, np.zeros((80, 80)), *blocks)
    found = mbdlft.robust_stability(system, work=0.03)
    assert 0.0 < found.lower <= found.upper  # what the norm proves
    assert mbdlft.verify(system, found) == ""
    assert "multipliers would have 800 entries, and are zero between pieces" in found.reason
    assert np.isfinite(found.upper)


def test_stability_of_the_nominal_is_proved_and_not_seen() -> None:
    assert is_hurwitz(np.array([[-1e-12, 1.0], [-1.0, -1e-12]]))
    assert not is_hurwitz(np.array([[1e-12, 1.0], [-1.0, -1e-12]]))
    assert not is_hurwitz(np.array([[0.0, 1.0], [-1.0, 0.0]]))
    assert not is_hurwitz(np.array([[0.0]]))
    assert is_hurwitz(np.zeros((0, 0)))


def test_no_rates_are_those_of_constants() -> None:
    mixed = of_matrices(-np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), mbdlft.Block("d", 1))
    assert mbdlft.robust_stability(mixed, rates=0.0).rates == {}


def test_more_states_than_the_inequality_carries_are_said() -> None:
    random, n = np.random.default_rng(0), 16
    B, C = random.standard_normal((n, 1)), random.standard_normal((1, n))
    system = of_matrices(-np.diag(np.arange(1.0, n + 1)), B, C, np.zeros((1, 1)), mbdlft.Block("d", 1))
    found = mbdlft.robust_stability(system, rates=np.inf, work=0.003)
    assert found.lower > 0.0
    assert mbdlft.verify(system, found) == ""
    assert "a matrix inequality of 16 states and 17 signals" in found.reason
