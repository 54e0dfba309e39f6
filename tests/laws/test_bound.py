"""Laws of the lower bound."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import schur

import mbdlft
from benchmarks.cases.chains import chain
from mbdlft import Angle, MatrixProblem, Parameter, exact_lower_bound
from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT, Block, constant, delta, inverse, stack_diagonal, with_blocks
from mbdlft.lft.sampling import evaluate, evaluate_at
from mbdlft.multibody.assembly import assemble
from mbdlft.order import degree as bound
from mbdlft.order import lower_bound as exact
from mbdlft.order.degree import Bound, degree_bounds
from mbdlft.order.reduction import reduce_order
from mbdlft.problem.relations import linearize
from tests import kit
from tests.close import roundoff
from tests.extracted import exactly, extracted, lower_bound
from tests.laws.lfts import DENOMINATOR, lfts, padded, sparse_lfts
from tests.laws.loewner import degrees as degrees_by_ranks
from tests.laws.loewner import exact_degree
from tests.laws.test_reduction import KAPPA, values
from tests.strategies import fewer


def law_degrees(a: LFT) -> None:
    random = np.random.default_rng(0)
    for name, found in degree_bounds(a).items():
        degree = exact_degree(a, name, random)
        assert found.degree <= degree
        assert found.degree == degree or found.doubtful


@given(sparse_lfts())
def test_degrees_of_exact_arithmetic(a: LFT) -> None:
    law_degrees(a)


def some_lft(seed: int) -> LFT:
    """Up to 12 channels, few entries, small fractions: most of them matter to nothing."""
    random = np.random.default_rng(seed)
    blocks = tuple(Block(name, int(random.integers(0, 7))) for name in ("a", "b"))
    n, n_out, n_in = sum(block.size for block in blocks), *random.integers(1, 4, 2)
    density = random.choice([0.1, 0.15, 0.3, 0.6])

    def some(rows: int, columns: int) -> np.ndarray:
        entries = random.integers(-3, 4, (rows, columns)) / DENOMINATOR
        return entries * (random.random((rows, columns)) < density)

    return LFT(some(n, n), some(n, n_in), some(n_out, n), some(n_out, n_in), blocks)


def test_error_that_vanishes() -> None:
    """Moving the entries changes nothing at some points: what is left is the rounding of the matrix."""
    for seed in (305, 4004, 8177):
        law_degrees(some_lft(seed))


def test_inputs_and_outputs_of_very_different_sizes() -> None:
    a, random = some_lft(43322), np.random.default_rng(43322)
    columns = 2.0 ** random.integers(-30, 30, a.shape[1])
    rows = 2.0 ** random.integers(-20, 20, (a.shape[0], 1))
    law_degrees(LFT(a.M11, a.M12 * columns, rows * a.M21, rows * a.M22 * columns, a.blocks))


def test_constant_in_padded_channels() -> None:
    """Channels that nothing reaches or nobody sees: their functions are rounding of terms that cancel."""
    a = with_blocks(constant([[1.5]]), ["a", "b"])
    for seed in range(100, 300):
        degrees = degree_bounds(padded(a, np.random.default_rng(seed)))
        assert {name: found.degree for name, found in degrees.items()} == {"a": 0, "b": 0}


def poles_of_high_order() -> LFT:
    """(1 + x^2)^-10 with x = 0.75 + t/4: two poles of order 10."""
    x = np.array([[0.75]]) + 0.25 * np.eye(1) @ delta("t")
    factor = inverse(np.eye(1) + x @ x)
    a = factor
    for _ in range(9):
        a = a @ factor
    return reduce_order(a)


def test_poles_of_high_order() -> None:
    assert degree_bounds(poles_of_high_order())["t"] == Bound(20, 0)


@pytest.mark.parametrize(
    ("power", "expected"), [(-20, (2, 0)), (-30, (2, 0)), (-43, (1, 1)), (-51, (1, 0))]
)
def test_what_is_not_clear_is_doubtful(power: int, expected: tuple[int, int]) -> None:
    """delta [1 1 ; 1 1+e] has degree 2; when e is as small as rounding, that cannot be seen."""
    a = np.array([[1.0, 1.0], [1.0, 1.0 + 2.0**power]]) @ delta("d", 2)
    assert degree_bounds(a)["d"] == Bound(*expected)


def test_a_twin_says_what_may_be_wrong() -> None:
    """The second rank of a matrix that is known to a part in 2^20 is not proved."""

    def known(entry: float) -> LFT:
        return np.array([[1.0, 1.0], [1.0, entry]]) @ delta("d", 2)

    a = known(1.0 + 2.0**-20)
    assert degree_bounds(a)["d"] == Bound(2, 0)
    assert degree_bounds(a, known(1.0 + 2.0**-21))["d"] == Bound(1, 1)


@pytest.mark.parametrize(
    ("fails", "expected"), [({"complex"}, Bound(20, 0)), ({"complex", "real"}, Bound(0, 20))]
)
def test_an_iteration_without_an_end(
    monkeypatch: pytest.MonkeyPatch, fails: set[str], expected: Bound
) -> None:
    """The Schur form is that of real numbers then; without any, nothing is proved and all is doubtful."""

    def failing(matrix: np.ndarray, output: str = "real") -> tuple[np.ndarray, np.ndarray]:
        if output in fails:
            raise np.linalg.LinAlgError
        T, Z = schur(matrix, output=output)
        return T, Z

    monkeypatch.setattr(bound, "schur", failing)
    assert degree_bounds(poles_of_high_order())["t"] == expected


def test_what_cancels_does_not_count() -> None:
    """diag(t, (p q - q p) t) is diag(t, 0): terms that cancel leave rounding, which is not rank."""
    p, q, t = (np.array([[0.3]]) + delta(name) for name in ("p", "q", "t"))
    for seed in range(20):
        a = stack_diagonal(t, (p @ q - q @ p) @ t)
        assert lower_bound(a, seed) == {"p": 0, "q": 0, "t": 1}


def test_degrees_of_a_chain() -> None:
    """85 in exact arithmetic modulo 2^61 - 1, of which mass k has k + 1: the joints that it loads."""
    equations = assemble(chain(6, spatial=False))
    found = degree_bounds(reduce_order(extracted(linearize(equations, range(6), range(6)))))
    assert sum(item.degree for item in found.values()) == 85
    assert [found[f"m{k}"].degree for k in range(6)] == [1, 2, 3, 4, 5, 6]
    assert not any(item.doubtful for item in found.values())


# Ranks without a tolerance: hard scales, many parameters, one parameter very often.
# The right orders are known by construction: a minimal LFT is hidden by a similarity transformation of
# each block, and by channels that nothing reaches or nobody sees.

TWELVE = (1e-6, 1.0, 1e6)


def scaled_scene(mass: float, length: float) -> mbdlft.Scene:
    """A slide on a swinging arm with its masses and lengths in other sizes; the time stays."""
    inertia, stiffness = mass * length**2, mass
    parameters = [
        mbdlft.Parameter("m", 2.0 * mass, percent=30, unit="kg"),
        mbdlft.Parameter("L", 0.8 * length, percent=20, unit="m"),
        mbdlft.Parameter("J", 0.3 * inertia, percent=10, unit="kg m^2"),
        mbdlft.Parameter("k", 7.0 * stiffness, percent=50, unit="N/m"),
        mbdlft.Angle("t", 20.0, -30.0, 60.0),
    ]
    arm = kit.body("arm", 1.5 * mass, xx="J", center_of_mass=(0, "0.4*L", 0), ports={"tip": (0, "L", 0)})
    swing = kit.hinge("swing", "ground", "arm", (1, 0, 0), position="t", damping=0.1 * inertia)
    slide = kit.rail("slide", "arm.tip", "load", (0, 1, 0), position=0.2 * length, stiffness="k")
    return kit.scene(
        "slide", *parameters, arm, kit.point("load", "m"), swing, slide, gravity=(0, 0, -9.81 * length)
    )


@pytest.mark.parametrize("length", TWELVE)
@pytest.mark.parametrize("mass", TWELVE)
def test_units_do_not_change_ranks(mass: float, length: float) -> None:
    """Micrograms to kilotons, micrometers to megameters: order and bound are those of kg and m."""
    found = mbdlft.to_lft(scaled_scene(mass, length), search=0.0).certificate
    expected = mbdlft.to_lft(scaled_scene(1.0, 1.0), search=0.0).certificate
    assert found.order == expected.order
    assert found.lower_bound == expected.lower_bound
    assert not any(found.doubtful)


def minimal(sizes: dict[str, int], signals: int, seed: int = 0) -> LFT:
    """A random LFT; a random LFT with as many signals as its largest block is minimal."""
    random = np.random.default_rng(seed)
    blocks = tuple(Block(name, size) for name, size in sorted(sizes.items()))
    n = sum(sizes.values())
    M11 = random.standard_normal((n, n))
    M11 *= 0.6 / np.linalg.norm(M11, 2)
    M12, M21 = random.standard_normal((n, signals)), random.standard_normal((signals, n))
    return LFT(M11, M12, M21, random.standard_normal((signals, signals)), blocks)


def rescaled(a: LFT, decades: float, random: np.random.Generator) -> LFT:
    """Inputs, outputs and channels in units of random sizes."""

    def sizes(count: int) -> Array:
        return 10.0 ** random.uniform(-decades, decades, count)

    inputs, outputs, channels = sizes(a.shape[1]), sizes(a.shape[0]), sizes(a.order)
    return LFT(
        channels[:, None] * a.M11 / channels,
        channels[:, None] * a.M12 * inputs,
        outputs[:, None] * a.M21 / channels,
        outputs[:, None] * a.M22 * inputs,
        a.blocks,
    )


@pytest.mark.parametrize("seed", range(5))
def test_scales_over_twelve_orders(seed: int) -> None:
    random = np.random.default_rng(seed)
    right = minimal({"a": 5, "b": 3, "c": 4, "d": 1}, 3, seed)
    hidden = rescaled(padded(right, random), 6.0, random)
    small = reduce_order(hidden)
    assert small.blocks == right.blocks
    for item in (hidden, small):
        assert lower_bound(item) == dict(right.blocks)
        assert not any(found.doubtful for found in degree_bounds(item).values())


def test_forty_parameters() -> None:
    random = np.random.default_rng(1)
    right = minimal({f"p{k:02d}": 1 + k % 4 for k in range(40)}, 4)
    hidden = padded(right, random)
    assert hidden.order == right.order + 80
    small = reduce_order(hidden)
    assert small.blocks == right.blocks
    assert lower_bound(small) == lower_bound(hidden) == dict(right.blocks)
    points = random.uniform(-1.0, 1.0, (3, 40))
    roundoff(*(evaluate_at(item, points) for item in (small, right)), KAPPA)


def power(count: int) -> LFT:
    """delta^count: a chain of channels, minimal."""
    eye = np.eye(count)
    return LFT(np.eye(count, k=1), eye[:, -1:], eye[:1], np.zeros((1, 1)), (Block("a", count),))


@pytest.mark.parametrize("count", [150, pytest.param(500, marks=pytest.mark.long)])
def test_one_parameter_very_often(count: int) -> None:
    """delta^count, hidden in two channels more."""
    small = reduce_order(padded(power(count), np.random.default_rng(2)))
    assert small.order == count
    assert degree_bounds(small)["a"] == (count, 0)
    roundoff(values(small, 3), values(power(count), 3), KAPPA)


def test_500_repetitions_of_which_10_are_needed() -> None:
    """A sum of 100 copies of delta/(1 - p delta) R_p with R_p of full rank 2, for 5 values of p."""
    random = np.random.default_rng(3)
    poles = np.repeat([-0.5, -0.2, 0.1, 0.3, 0.6], 100)
    M12, M21 = random.standard_normal((500, 2)), random.standard_normal((2, 500))
    T, _ = np.linalg.qr(random.standard_normal((500, 500)))
    many = LFT(T * poles @ T.T, T @ M12, M21 @ T.T, np.zeros((2, 2)), (Block("a", 500),))
    small = reduce_order(many)
    assert small.order == 10
    assert degree_bounds(small)["a"] == (10, 0)
    d = 0.7
    expected = (M21 * (d / (1.0 - poles * d))) @ M12
    roundoff(evaluate(small, {"a": d}), expected, KAPPA)


# Laws of bounds in exact arithmetic.

A, B = Parameter("a", 0.5, 0.3, 0.8), Parameter("b", 1.5, 1.0, 2.0)


def bound_exact(*rows: list[str], parameters: tuple[Parameter, ...] = (A, B)) -> dict[str, int]:
    return exact_lower_bound(MatrixProblem(matrix=rows, parameters=parameters))


CLOSED = [
    ([["3"]], (0, 0)),
    ([["a - a"]], (0, 0)),
    ([["a^7 + 2*a - 1"]], (7, 0)),
    ([["a*b + a*b^2"]], (1, 2)),
    ([["(a - 0.5)*(b - 1.5)"]], (1, 1)),
    ([["1/(1 + a)^3"]], (3, 0)),
    ([["a^2/((1 + a)*(2 + a))"]], (2, 0)),
    ([["(a^2 - 1)/(a + 1)"]], (1, 0)),
    ([["a", "0"], ["0", "a"]], (2, 0)),
    ([["a", "a*b"], ["a*b", "a*b^2"]], (1, 2)),
    ([["a", "2*a"], ["b", "a + b"]], (2, 1)),
    ([["0.1*a + 0.2*a - 0.3*a"]], (0, 0)),
]


def law_closed_form(matrix: list[list[str]], degrees: tuple[int, int]) -> None:
    assert bound_exact(*matrix) == dict(zip("ab", degrees, strict=True))


@pytest.mark.parametrize(("matrix", "degrees"), CLOSED, ids=lambda item: str(item)[:30])
def test_degrees_known_in_closed_form(matrix: list[list[str]], degrees: tuple[int, int]) -> None:
    law_closed_form(matrix, degrees)


entries = st.recursive(
    st.sampled_from(["a", "b", "2", "0.7", "(1 + a)", "(3 + b)"]),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*"), inner).map(lambda t: f"({t[0]} {t[1]} {t[2]})"),
        inner.map(lambda text: f"({text}/(4 + a*b))"),
    ),
    max_leaves=6,
)


@fewer
@given(st.lists(st.lists(entries, min_size=2, max_size=2), min_size=2, max_size=2))
def test_no_model_is_smaller_and_another_prime_says_the_same(matrix: list[list[str]]) -> None:
    proved = bound_exact(*matrix)
    problem = MatrixProblem(matrix=matrix, parameters=(A, B))
    model = mbdlft.realize(problem, search=0.0)
    assert proved == degrees_by_ranks(matrix, "ab")
    for name, order, claimed in zip(
        "ab", model.certificate.order, model.certificate.lower_bound, strict=True
    ):
        assert claimed == proved[name] <= order
    doubled = [[f"({text} + b*a - a*b)" for text in row] for row in matrix]
    assert bound_exact(*doubled) == proved


@pytest.mark.parametrize(
    ("text", "degree"),
    [
        ("sin(th)", 2),
        ("sin(th)^2 + cos(th)^2", 0),
        ("sin(2*th)", 4),
        ("sin(2*th) - 2*sin(th)*cos(th)", 0),
        ("cos(th + 90*deg) + sin(th)", 0),
    ],
)
def test_angles(text: str, degree: int) -> None:
    for substitution in ("half-angle", "quarter-angle"):
        angle = Angle("th", 30, 10, 50, substitution=substitution)
        factor = 1 if substitution == "half-angle" else 2
        assert bound_exact([text], parameters=(angle,)) == {"th": degree * factor}


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        ("sqrt(2)*a", (1, 0)),
        ("sqrt(2)*a*sqrt(3) - a*sqrt(6)", (0, 0)),
        ("pi*a - 180*deg*a", (0, 0)),
        ("a*sin(0.3)^2 + a*cos(0.3)^2 - a + b", (0, 1)),
        ("a + (cos(60*deg) - 0.5)*b", (1, 0)),
        ("a + (cos(60*deg) - 0.500000000001)*b", (1, 1)),
    ],
)
def test_constants_have_their_relations(text: str, degrees: tuple[int, int]) -> None:
    law_closed_form([[text]], degrees)


def test_denominator_that_is_zero_everywhere_is_refused() -> None:
    with pytest.raises(mbdlft.WellPosednessError, match="vanishes in the range"):
        bound_exact(["1/(a*b - b*a)"])


@given(lfts(2, 2))
def test_degrees_are_not_above_the_order(a: mbdlft.LFT) -> None:
    found = exact.exact_degrees(exactly(a))
    assert all(degree <= dict(a.blocks)[name] for name, degree in found.items())


def test_degrees_of_an_lft_that_is_not_minimal() -> None:
    """(p q - q p) t is zero, though every channel is seen and reached."""
    p, q, t = (constant([[0.25]]) + delta(name) for name in "pqt")
    cases = [
        (t + (p @ q - q @ p) @ t, {"p": 0, "q": 0, "t": 1}),
        (p @ q @ p + t @ t, {"p": 2, "q": 1, "t": 2}),
        (inverse(1.0 + p @ q) @ t, {"p": 1, "q": 1, "t": 1}),
    ]
    for a, degrees in cases:
        assert exact.exact_degrees(exactly(a)) == degrees
