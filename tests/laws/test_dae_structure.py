"""Laws of the structure of DAEs: index, states, order of solving, aliases, and linear models of them."""

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.base import Parameter
from mbdlft.base.errors import SceneError
from mbdlft.dae import DaeDraft, from_casadi, reduce_index, trim
from mbdlft.dae.linear import linearized, slopes_of, trimmed_points
from mbdlft.dae.newton import System, follow_all
from mbdlft.pipeline import linearize_dae
from tests.close import CLOSED_FORM, CROSS, finite_difference, target
from tests.daes import Known, coupled_inertias, differences, example_2, pendulum, random_dae, servo
from tests.seeds import some

FREQUENCIES = (0.37, 1.3, 9.0)


def _transfer(A, B, C, D, w):  # type: ignore[no-untyped-def]
    return C @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B) + D


def test_solutions_stay_on_the_branch_of_the_first() -> None:
    """sin z = q from q = -0.99: Newton's first step from there to 0.99 is 14 rad long."""
    z, q = ca.SX.sym("z"), ca.SX.sym("q")
    ends = np.array([[0.99], [-0.5], [0.999], [0.4]])
    start, first = np.arcsin(np.array([-0.99])), np.array([-0.99])
    found = follow_all(System(ca.sin(z) - q, z, q), start, first, ends, np.ones(1))
    target(np.array([at.values for at in found]), np.arcsin(ends), CLOSED_FORM)


def _as_known(known: Known, seed: int) -> None:
    structure = reduce_index(known.dae, states=known.states)
    assert structure.index == known.index
    model = linearize_dae(structure, search=0.0, prove=0.0)
    drawn = np.random.default_rng(seed)
    for _ in range(2):
        values = {p.name: float(drawn.uniform(p.low, p.high)) for p in known.dae.parameters}
        ordered = [values[f"p{k}"] for k in range(len(values))]
        A, B, C = (part.full() for part in known.matrices(ordered))
        found = mbdlft.matrices_at(model, values)
        for w in FREQUENCIES:
            expected = _transfer(A, B, C, 0.0, w)
            size = max(float(np.max(np.abs(expected))), 1e-3)
            target(_transfer(*found, w), expected, CROSS, scale=size)


@pytest.mark.parametrize("seed", some(range(12), range(224)))
def test_random_daes_have_the_known_linear_model(seed: int) -> None:
    _as_known(random_dae(seed), seed)


@pytest.mark.long
def test_index_is_that_of_casadi() -> None:
    """`casadi.dae_reduce_index` has Pantelides' algorithm of its own."""
    for dae in (pendulum(), coupled_inertias()):
        x = [v for v in dae.variables if v.derivative is not None]
        z = [v for v in dae.variables if v.derivative is None]
        u = ca.vertcat(*(v.symbol for v in dae.inputs))
        free = ca.substitute(ca.vertcat(*(e.residual for e in dae.equations)), u, 0)
        given = {
            "x_impl": ca.vertcat(*(v.symbol for v in x)),
            "dx_impl": ca.vertcat(*(v.derivative for v in x)),
            "z": ca.vertcat(*(v.symbol for v in z)),
            "p": ca.vertcat(dae.p, *ca.symvar(free)[:0]),
            "alg": ca.SX(mbdlft.problem.sx.constants.in_doubles(free)),
        }
        _, stats = ca.dae_reduce_index(given, {})
        assert reduce_index(dae).index == stats["index"]


def test_states_can_be_chosen() -> None:
    chosen = reduce_index(pendulum(0.6), states=["y", "vy"])
    assert [q.name for q in chosen.states] == ["y", "vy"]
    assert len(reduce_index(pendulum(0.6)).states) == 2


def test_blocks_are_in_the_order_of_solving() -> None:
    for dae in (example_2(), pendulum(), servo()):
        s = reduce_index(dae)
        pattern = ca.DM(ca.jacobian_sparsity(s.residual, s.unknown), 1.0).full()
        known: set[int] = set()
        for block in s.blocks:
            known |= set(block.columns)
            for row in block.rows:
                assert set(np.flatnonzero(pattern[row])) <= known
        assert known == set(range(len(s.unknowns)))


def test_aliases_are_what_they_say() -> None:
    s = reduce_index(example_2())
    of = {a.name: (a.of, float(a.factor)) for a in s.aliases}
    assert of["J2.flange_b.tau"] == (None, 0.0)
    assert of["J1.flange_a.tau"] == ("tau", 1.0)
    assert of["sensor.phi"] == ("J2.phi", 1.0) or of["J2.phi"] == ("sensor.phi", 1.0)
    assert "8 blocks" in str(s) or "9 blocks" in str(s)


def test_negative_aliases_and_numbers() -> None:
    d = DaeDraft("signs")
    x, y, z, c = (d.variable(name) for name in ("x", "y", "z", "c"))
    u = d.input("u")
    d.equation(d.der(x) + 2 * x, equals=u + c)
    d.equation(y + x, "minus")
    d.equation(-z, equals=y)
    d.equation(2 * c, "number", equals=d.number(0.3))
    d.output("z")
    s = reduce_index(d.dae())
    assert {str(a) for a in s.aliases} == {"y = -x", "z = x", "c = 0.15"}
    model = linearize_dae(s)
    assert mbdlft.matrices_at(model, {}).A[0, 0] == -2.0


def test_linearization_is_of_second_order_in_the_step() -> None:
    """Richardson: halving a difference's step leaves a quarter of its error."""
    dae = servo()
    s = reduce_index(dae)
    at = trim(s)
    points = np.array([[p.nominal for p in dae.parameters]])
    z, p = trimmed_points(at, points), points[0]
    exact = linearized(s, slopes_of(s), z, points)[0]
    model = linearize_dae(s, search=0.0)
    M = mbdlft.matrices_at(model, {})
    target(np.block([[M.A, M.B], [M.C, M.D]]), exact, CROSS)
    errors = [np.max(np.abs(differences(s, z[0], p, h) - exact)) for h in (0.02, 0.01, 0.005)]
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all((rates > 1.9) & (rates < 2.1))
    extrapolated = (4 * differences(s, z[0], p, 1e-3) - differences(s, z[0], p, 2e-3)) / 3
    finite_difference(extrapolated, exact)


def test_a_builder_of_casadi() -> None:
    b = ca.DaeBuilder("tank")
    h, q, u = b.add("h", "output"), b.add("q"), b.add("u", "input")
    a, c = b.add("a", "parameter", "tunable"), b.add("c", "parameter", "tunable")
    b.set_min("a", 1.0)
    b.set_max("a", 3.0)
    b.set_nominal("a", 2.0)
    b.set_start("c", 0.3)
    b.eq(b.der(h), (u - q) / a)
    b.eq(0, q - c * h - h**3)
    dae = from_casadi(b)
    assert [p.name for p in dae.parameters] == ["a"]
    model = linearize_dae(dae)
    values = np.array([1.0, 2.0, 3.0])
    target(mbdlft.matrices_at(model, {"a": values}).A[:, 0, 0], -0.3 / values, CROSS)
    assert linearize_dae(from_casadi(b, [Parameter("c", 0.3, percent=10)])).order == 2


def test_derivatives_of_inputs_can_be_inputs() -> None:
    d = DaeDraft("imposed")
    m = d.parameter(Parameter("m", 2.0, percent=10, unit="kg"))
    u, x = d.input("u", "m"), d.variable("x", "m")
    v, F = d.variable("v", "m/s"), d.variable("F", "N")
    d.equation(d.der(x), "v", equals=v)
    d.equation(m * d.der(v), "F", equals=F)
    d.equation(x, "drive", equals=2 * u)
    d.output("F")
    s = reduce_index(d.dae(), input_rates="inputs")
    assert [q.name for q in s.inputs] == ["u", "der(u)", "der(u, 2)"]
    D = mbdlft.matrices_at(linearize_dae(s), {"m": 2.1}).D
    target(D, [[0.0, 0.0, 4.2]], CROSS)


def test_a_number_takes_the_unit_of_what_it_is_added_to() -> None:
    d = DaeDraft("units")
    x, t = d.variable("x", "m"), d.variable("t", "s")
    d.equation(3 + x, "sum", equals=t)
    d.equation(d.der(x), "rate", equals=1)
    with pytest.raises(SceneError, match=r"equation 'sum': m and s are added"):
        reduce_index(d.dae())
