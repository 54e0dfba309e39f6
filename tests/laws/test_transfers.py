"""Laws of transfer functions as certificates compare them."""

from dataclasses import replace
from fractions import Fraction

import flint
import numpy as np
import pytest

import mbdlft
from mbdlft import LFTModel, Parameter, realize
from mbdlft.exact.numbers import precision
from mbdlft.exact.rounding import conditioning
from mbdlft.lft.lft import LFT, Block, add, constant, delta, inverse, multiply
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.pipeline.certification import measure_error
from mbdlft.problem import references
from mbdlft.problem.digits import BITS, transfers_of
from mbdlft.problem.relations import Problem
from mbdlft.system import regular, sampled
from mbdlft.system.regular import Box, physical_boxes, regularity
from tests import kit
from tests.close import EPS, EVALUATION, conditioned, roundoff
from tests.laws.planted_singular import RADIUS, planted
from tests.reference.chain_of_beams import scene as beams
from tests.seeds import some


@pytest.fixture(scope="module")
def arm() -> Problem:
    return problem_of_scene(mbdlft.load_scene("scenarios/two_link_arm.toml"))


def test_of_a_mass_and_a_spring() -> None:
    m, d, k, w = 2.0, 0.3, 8.0, np.array([0.0, 0.5, 2.0, 40.0])
    matrices = np.array([[[0.0, 1, 0], [-k / m, -d / m, 1 / m], [1, 0, 0], [-k / m, -d / m, 1 / m]]])
    position = 1.0 / (k - m * w**2 + 1j * w * d)
    expected = np.stack([position, -(w**2) * position], axis=1)[None, :, :, None]
    roundoff(references.transfers(matrices, 2, w), expected)
    # m v' + d v + k x - f, x' - v: solved for nothing
    slopes = np.array([[[1.0, 0, 0, -1, 0], [0, m, k, d, -1], [0, 0, 1, 0, 0], [0, 1, 0, 0, 0]]])
    roundoff(references.implicit_transfers(slopes, (2, 3, 2), w), expected)


def test_frequencies_are_around_the_poles_and_beside_them() -> None:
    A = np.array([[0.0, 1.0, 0.0], [-400.0, 0.0, 0.0], [0.0, 0.0, -0.5]])
    found = references.frequencies_of(A[None])
    assert found[0] < 0.1
    assert found[-1] > 20.0
    poles = np.abs(np.linalg.eigvals(A))
    assert np.min(np.abs(found[:, None] / poles - 1.0)) > 0.009
    for nothing in (np.zeros((1, 0, 0)), np.zeros((3, 2, 2))):
        assert np.all(references.frequencies_of(nothing) > 0.0)
    first = found[3] * 1.001
    again = references.frequencies_of(np.array([A, np.diag([-0.5, -first, -20.0])]))
    assert np.min(np.abs(again / first - 1.0)) > 0.009


def test_what_errors_are_relative_to() -> None:
    truth = np.zeros((1, 2, 3, 2), dtype=complex)
    truth[0, :, 0] = [[1.0, 0.1], [1e-3, 1e-4]]  # within the quiet of its row
    truth[0, :, 1] = [[1.0, 1.0], [1e-9, 0.0]]  # below it
    for row, size in ((0, 1e-3), (1, references.QUIET)):
        found = truth.copy()
        found[0, 1, row, 1] += 1e-8
        roundoff(references.largest_of_rows(found, truth), 1e-8 / size, kappa=1e8)
    found = truth.copy()
    found[0, :, 2] = 1.0  # a row of zeros has no size
    assert references.largest_of_rows(found, truth) == 0.0


def test_references_agree(arm: Problem) -> None:
    at, states = arm.reference(), len(arm.states)
    frequencies = references.frequencies_of(at.values[:1, :states, :states])
    digits = at.transfers_in_digits([0, 5], frequencies)
    assert references.largest_of_rows(at.transfers([0, 5], frequencies), digits) < 100.0 * EVALUATION
    assert (
        references.largest_of_rows(references.transfers(at.values[[0, 5]], states, frequencies), digits)
        < 1e-12
    )


def test_references_of_a_matrix_agree() -> None:
    problem = mbdlft.MatrixProblem(
        matrix=[["-1 - a", "2", "1"], ["-2", "-3*b", "0"], ["1", "b", "0"], ["1e9 + a", "1", "-1e9"]],
        parameters=[mbdlft.Parameter("a", 1, 0.5, 2), mbdlft.Parameter("b", 1, 0.5, 2)],
        states=["x1", "x2"],
    )
    model = mbdlft.realize(problem)
    assert 0.0 < model.certificate.transfer_error < 1e-12


def test_the_reference_is_that_of_what_was_not_solved(arm: Problem) -> None:
    """A derivative that is wrong in all of A, B, C and D of the reference is found by transfers."""
    scene = mbdlft.load_scene("scenarios/two_link_arm.toml")
    at, right = arm.reference(), mbdlft.to_lft(scene, search=0.0).lft
    wrong, lft = 1.001 * at.values, replace(right, M21=1.001 * right.M21, M22=1.001 * right.M22)
    with pytest.raises(mbdlft.AnalysisError, match="a transfer function of the model differs from"):
        measure_error(arm, lft, None, replace(at, values=wrong))

    def in_digits(points: np.ndarray) -> np.ndarray:
        return wrong[[int(np.argmin(np.abs(arm.points - p).sum(axis=1))) for p in points]]

    with pytest.raises(mbdlft.AnalysisError, match="a transfer function of the model differs from"):
        measure_error(arm, lft, None, replace(at, values=wrong, in_digits=in_digits))
    found = measure_error(arm, right, None, at)
    assert 0.0 < found.transfer_error < 1e-12
    assert len(found.frequencies) == 8


PLANTED = 1.0 + 1e-9


def test_small_errors_are_no_rounding(arm: Problem) -> None:
    """A trim and a transfer function that are wrong by 1e-9, and states that are left out and matter."""
    model = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
    at, trim = arm.reference(), model.trim.lft
    assert trim is not None
    measure_error(arm, model.lft, trim, at)
    wrong = replace(trim, M21=PLANTED * trim.M21, M22=PLANTED * trim.M22)
    with pytest.raises(mbdlft.AnalysisError, match=r"torque of the trim differs from .* rounding"):
        measure_error(arm, model.lft, wrong, at)

    def transfers_in_digits(some: list[int], frequencies: np.ndarray) -> np.ndarray:
        return PLANTED * at.transfers_in_digits(some, frequencies)

    moved = replace(
        at,
        transfers=lambda some, frequencies: PLANTED * at.transfers(some, frequencies),
        transfers_in_digits=transfers_in_digits,
    )
    with pytest.raises(mbdlft.AnalysisError, match=r"a transfer function .* rounding"):
        measure_error(arm, model.lft, trim, moved)
    with pytest.raises(mbdlft.AnalysisError, match=r"states that are left out .* rounding"):
        measure_error(arm, model.lft, trim, replace(at, omitted=lambda: 1e6))


def test_what_rounding_makes_of_transfers() -> None:
    """1/(s + a) with a changed by a rounding, where s is near the pole."""
    a, w = 1e-3, np.array([1e-6, 1.0])
    matrices = np.array([[[-a, 1.0], [1.0, 0.0]]])
    rounding = np.array([[1e-12, 0.0], [0.0, 0.0]])
    found = references.rounded_transfers(matrices, 1, w, rounding)[0, :, 0, 0]
    expected = (1e-12 + EPS * np.abs(1j * w + a)) / np.abs(1j * w + a) ** 2
    roundoff(found, expected)
    moved = matrices - rounding
    change = np.abs(references.transfers(moved, 1, w) - references.transfers(matrices, 1, w))[0, :, 0, 0]
    assert np.all(change <= 1.001 * found)


@pytest.mark.parametrize(
    ("masses", "springs", "relative"),
    [
        ([0.5, 31.0], [2.25e8, 1918.5], False),
        ([0.033, 6.099, 2.401, 22.078], [1463354127.8531, 1151.8781, 0.2156, 1082.0518], True),
    ],
)
def test_transfers_have_the_digits_of_their_matrices(
    masses: list[float], springs: list[float], relative: bool
) -> None:
    """A stiff spring to the ground and weak ones beyond; the second takes three steps of refinement."""
    n = len(masses)
    stretch = np.eye(n) - np.eye(n, k=-1)
    pulled, pushed = -(stretch.T * springs) / np.array(masses)[:, None], np.diag(1.0 / np.array(masses))
    pulled, pushed = (stretch @ pulled, stretch @ pushed) if relative else (pulled @ stretch, pushed)
    rates = np.hstack([pulled, np.zeros((n, n)), pushed])
    matrices = np.vstack([np.eye(n, 3 * n, k=n), rates, rates])
    w = references.frequencies_of(matrices[None, : 2 * n, : 2 * n])
    with precision(BITS):
        balls = np.array([[flint.arb(float(x)) for x in row] for row in matrices])
        truth = transfers_of([balls], 2 * n, w)
    found = references.transfers(matrices[None], 2 * n, w)
    change = references.rounded_transfers(matrices[None], 2 * n, w, EPS * np.abs(matrices))
    assert np.all(np.abs(found - truth) <= 10.0 * change)


def test_weak_spring_behind_a_stiff_one_is_no_bug() -> None:
    """What elimination loses of an acceleration is no error of the model."""
    scene = kit.scene(
        "line",
        Parameter("m", 6.0, percent=20, unit="kg"),
        kit.point("near", "m"),
        kit.point("far", 28.6),
        kit.rail("held", "ground", "near", (1, 0, 0), stiffness=189000.0, preload=0.0),
        kit.rail("loose", "ground", "far", (1, 0, 0), position=1.0),
        kit.spring("weak", "near", "far", stiffness=1.757, damping=0.087, force_density=0.0),
        kit.force("push", "far", (1, 0, 0), frame="ground", magnitude=0.0),
        inputs=["push.force"],
        outputs=["held.acceleration"],
    )
    certificate = mbdlft.to_lft(scene, search=0.0).certificate
    assert certificate.transfer_error < 1e-8


def test_rounding_is_counted_and_accepted() -> None:
    """A, B, C, D of many beams cannot be written in doubles with all digits of their accelerations."""
    certificate = mbdlft.to_lft(beams(3, 6), search=0.0).certificate
    assert certificate.max_relative_error < certificate.transfer_error < 1e-6


def test_without_states_or_inputs_nothing_is_recorded() -> None:
    certificate = mbdlft.realize([["1/(2 + a)"]], [mbdlft.Parameter("a", 0, -1, 1)]).certificate
    assert certificate.frequencies == ()
    assert certificate.transfer_error == 0.0


# The condition of the certificate: by hand, against a closed form, and in what is printed and stored.

G = 9.81


def column(*values: float) -> np.ndarray:
    """One entry at several points (N, 1, 1)."""
    return np.array(values)[:, None, None]


@pytest.mark.parametrize(
    ("values", "sizes", "scale", "expected"),
    [
        ((1.0, 2.0), (1.0, 2.0), 2.0, (1.0, 0)),
        ((1.0, 2.0), (5.0, 6.0), 2.0, (5.0, 0)),  # relative to itself: 5/1, not 6/2
        ((-1.0, -2.0), (5.0, 6.0), 2.0, (5.0, 0)),
        ((0.1, 2.0), (5.0, 6.0), 2.0, (10.0, 0)),  # negligible at a point: 5/0.5
        ((-0.5, 2.0), (5.0, 6.0), 2.0, (3.0, 1)),  # changes its sign: 6/2
        ((0.0, 2.0), (5.0, 6.0), 2.0, (3.0, 1)),  # vanishes at a point
        ((EPS, 2.0), (5.0, 6.0), 2.0, (3.0, 1)),  # nothing but rounding at a point
        ((EPS, 2 * EPS), (5.0, 6.0), 2.0, (1.0, 0)),  # nothing but rounding at all
        ((0.0, 0.0), (0.0, 0.0), 1.0, (1.0, 0)),
        ((1e-3, 2e-3), (0.5, 0.6), 0.1, (6.0, 0)),  # negligible: relative to its scale
        ((-1e-3, 2e-3), (0.5, 0.6), 0.1, (6.0, 0)),
    ],
)
def test_by_hand(
    values: tuple[float, ...], sizes: tuple[float, ...], scale: float, expected: tuple[float, int]
) -> None:
    condition, changes = conditioning(
        column(*values), column(*sizes), np.array([[scale]]), np.array([[0.5]])
    )
    conditioned(condition, expected[0], 1.0)
    assert changes == expected[1]


def test_no_entries() -> None:
    assert conditioning(np.zeros((2, 0, 3)), np.zeros((2, 0, 3)), *np.ones((2, 0, 3))) == (1.0, 0)


def buckling(near: float, far: float) -> mbdlft.Scene:
    """An inverted pendulum of 1 kg and 1 m whose spring balances gravity but for these parts of it."""
    low, high = sorted((G * (1.0 + near), G * (1.0 + far)))
    return kit.scene(
        "buckling",
        mbdlft.Parameter("k", 0.5 * (low + high), low=low, high=high, unit="N m/rad"),
        kit.point("bob", 1.0, ports={"foot": (0, 0, -1.0)}),
        kit.hinge("pivot", "ground", "bob.foot", (1, 0, 0), stiffness="k"),
        gravity=(0.0, 0.0, -G),
        inputs=["pivot.torque"],
        outputs=["pivot.acceleration"],
    )


@pytest.mark.parametrize("near", [1e-3, 1e-6, -1e-9])
def test_a_stiffness_that_nearly_cancels(near: float) -> None:
    """X = (m g - k)/m: its terms are (m g + k)/m, and solving adds X itself."""
    certificate = mbdlft.to_lft(buckling(near, 3.0 * near), search=0.0).certificate
    stiffness = G * (1.0 + near)
    expected = (G + stiffness) / abs(G - stiffness) + 1.0
    conditioned(certificate.condition, expected, 1.0 / abs(near))
    assert certificate.sign_changes == 0


def test_a_stiffness_that_changes_its_sign() -> None:
    """Terms of 2.2 m g at the upper end of the range, where the entry has its largest size 0.2 m g."""
    certificate = mbdlft.to_lft(buckling(-0.1, 0.2), search=0.0).certificate
    # the acceleration is an output, too
    assert certificate.sign_changes == 2
    conditioned(certificate.condition, 2.2 / 0.2 + 1.0, 100.0)


def test_it_is_printed(tmp_path, output) -> None:  # type: ignore[no-untyped-def]
    """Ill-conditioned problems are called so; changes of the sign are explained."""
    for scene, expected in (
        (buckling(1e-3, 3e-3), ["condition 2.0e+03: rounding of numbers alone may change"]),
        (buckling(-1e-9, -2e-9), ["ill-conditioned, condition 2.0e+09: ", "by 4.4e-07 of itself"]),
        (buckling(-0.1, 0.2), ["condition 1.2e+01: ", "; 2 entries change their sign"]),
    ):
        mbdlft.save(tmp_path / "a.h5", mbdlft.to_lft(scene, search=0.0))
        shown = " ".join(output("show", str(tmp_path / "a.h5")).split())
        assert all(text in shown for text in expected), shown
        assert ("ill-conditioned" in shown) == ("ill-conditioned" in expected[0])


def test_what_is_derived_does_not_keep_it() -> None:
    """Entries of an inverse have another condition; it is not recorded."""
    model = mbdlft.to_lft(buckling(1e-6, 2e-6), search=0.0)
    inverse = mbdlft.invert_channels(model, ["pivot"]).certificate
    assert (inverse.condition, inverse.sign_changes) == (0.0, 0)


# What is called regular on the whole box is; what is singular in a small ball never is called so.

WORK = 0.02
EYE = np.eye(1)


def inner(matrix: list[list[float]], *sizes: int) -> LFT:
    """An LFT of its M11 alone."""
    n = len(matrix)
    blocks = tuple(Block(f"p{k}", size) for k, size in enumerate(sizes))
    return LFT(np.array(matrix), np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0)), blocks)


@pytest.mark.parametrize("seed", some(range(30), range(530)))
def test_a_ball_that_is_singular_is_never_called_regular(seed: int) -> None:
    a, center = planted(seed)
    known = regularity(a, WORK)
    assert not known.is_proved
    if known.zero is not None:  # the sphere around the center, or what rounding makes of it
        assert np.linalg.norm(known.zero - center) < 10.0 * RADIUS
    else:
        assert any(np.all(np.abs(center - box.center) <= box.half) for box in known.open_boxes)


@pytest.mark.parametrize("seed", range(20))
def test_a_point_that_is_singular_is_never_called_regular(seed: int) -> None:
    """Without a change of sign, at one point: rounding may have removed it, and still it is not."""
    assert not regularity(planted(seed, 0.0)[0], WORK).is_proved


@pytest.mark.long
def test_what_is_far_from_singular_is_proved() -> None:
    found = [regularity(planted(seed, 0.1)[0], 1.0) for seed in range(16)]
    assert all(known.zero is None for known in found)
    assert sum(known.is_proved for known in found) >= 4


@pytest.mark.parametrize("work", [0.0, 1e-5, 1e-4, 1e-3])
def test_open_boxes_and_proved_parts_cover_the_box(work: float) -> None:
    """With little work the zero is in an open box, or it was found."""
    for seed in range(20):
        a, center = planted(seed)
        known = regularity(a, work)
        assert known.zero is not None or any(
            np.all(np.abs(center - box.center) <= box.half) for box in known.open_boxes
        )


@pytest.mark.parametrize("corner", [1.0, 1.0 - 2.0**-30, 1.0 + 2.0**-31, 1.0 + 2.0**-34])
def test_a_zero_at_the_corner_of_the_box(corner: float) -> None:
    """1 - delta/corner vanishes at the end, or so near to it that the model may be singular there."""
    assert not regularity(inner([[1.0 / corner]], 1)).is_proved


def test_near_the_corner() -> None:
    assert regularity(inner([[1.0 / (1.0 + 2.0**-9)]], 1)).is_proved


def test_loops_alone_matter() -> None:
    """A chain has the determinant 1, whatever its entries are."""
    assert regularity(inner([[0.0, 1e9], [0.0, 0.0]], 2)).is_proved
    assert regularity(inner([[0.0, 1e9], [1e-10, 0.0]], 1, 1)).is_proved
    known = regularity(inner([[0.0, 1e9], [1e-8, 0.0]], 1, 1))
    assert known.zero is not None
    assert abs(np.prod(known.zero) * 10.0 - 1.0) < 1e-9


def test_what_a_test_of_a_box_says_is_true() -> None:
    """The sum x > 0, P x < x in fractions, near the border."""
    random = np.random.default_rng(0)
    proved = 0
    for _ in range(200):
        P = random.random((3, 3))
        P *= (1.0 + random.uniform(-4.0, 4.0) * 2.0**-32) / max(abs(np.linalg.eigvals(P)))
        if regular._contracts(P[None], 3)[0]:
            proved += 1
            exact = [[Fraction(x) for x in row] for row in P.tolist()]
            gap = [[Fraction(i == j) - exact[i][j] for j in range(3)] for i in range(3)]
            minors = [gap[0][0], gap[0][0] * gap[1][1] - gap[0][1] * gap[1][0], _determinant(gap)]
            assert all(minor > 0 for minor in minors)  # of an M-matrix
    assert 20 < proved < 180


def _determinant(m: list[list[Fraction]]) -> Fraction:
    return (
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    )


def test_the_same_work_gives_the_same_boxes() -> None:
    a, _ = planted(7)
    first, second = (regularity(a, 1e-3) for _ in range(2))
    assert first.zero is None or np.array_equal(first.zero, second.zero)
    for one, other in zip(first.open_boxes, second.open_boxes, strict=True):
        assert np.array_equal(one.center, other.center)
        assert np.array_equal(one.half, other.half)


def test_physical_boxes() -> None:
    parameters = [Parameter("a", 2.0, 1.0, 4.0, unit="kg"), Parameter("b", 0.0, -1.0, 1.0)]
    boxes = physical_boxes([Box(np.array([-0.5]), np.array([0.5]))], ["a"], parameters)
    assert boxes == (((1.0, 2.0), (-1.0, 1.0)),)


def thin(width: float, *, prove: float = 1.0) -> LFTModel:
    """1/((x - 0.3)^2 + (y - 0.6)^2 + width^2), with a search for nothing."""
    parameters = [Parameter(name, 0.5, 0.0, 1.0) for name in "xy"]
    matrix = [[f"1/((x - 0.3)^2 + (y - 0.6)^2 + {width!r}^2)"]]
    return realize(matrix, parameters, search=0.0, prove=prove)


def test_more_work_proves_more() -> None:
    little = thin(0.05, prove=0.0).certificate
    assert little.well_posed == "sampled"
    assert little.open_boxes
    assert all(low <= high for box in little.open_boxes for low, high in box)
    much = thin(0.05).certificate
    assert much.well_posed == "proved"
    assert much.open_boxes == ()


def test_values_of_a_model_that_is_not_proved() -> None:
    """What is refused is singular; the others have values."""
    parameters = [Parameter("p", 0.0, -1.0, 1.0)]
    a = add(constant([[1.0]]), -2.0 * EYE @ delta("p"))
    found = np.linspace(-1.0, 1.0, 9)[:, None]
    lft = multiply(inverse(a), constant([[1.0]]))
    some = np.abs(1.0 - 2.0 * found[:, 0]) > 0.1
    sampled.check_regular_at(lft, found[some], parameters, "model 'm'")
