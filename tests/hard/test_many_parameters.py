"""Hundreds of parameters in one body or one entry: a model in seconds, or a reason why there is none."""

from itertools import pairwise

import numpy as np
import pytest

import mbdlft
from mbdlft import AnalysisError, Inertia, Parameter, RigidBody
from mbdlft.exact.numbers import BITS, precision
from mbdlft.lft.lft import LFT, Block
from mbdlft.matrix import MatrixProblem
from mbdlft.matrix.relations import problem_of_matrix
from mbdlft.order import circles, lower_bound
from mbdlft.order.circles import independent
from mbdlft.order.joint_bound import JointBound
from mbdlft.order.lower_bound import exact_degrees
from mbdlft.order.work import Work
from mbdlft.pipeline.forms import candidates
from tests.close import CLOSED_FORM, target
from tests.errors.scenes import cart


def numbered(count: int, unit: str = "1") -> list[Parameter]:
    return [Parameter(f"p{k}", 1.0, percent=10, unit=unit) for k in range(count)]


def products(parameters: list[Parameter]) -> str:
    """p0 p1 + p1 p2 + ..."""
    return " + ".join(f"{p.name}*{q.name}" for p, q in pairwise(parameters))


def test_more_than_a_thousand_that_the_model_depends_on() -> None:
    many = numbered(1100, "kg")
    with pytest.raises(AnalysisError, match=r"'cart_on_rail': depends on 1100 parameters; at most 1000"):
        mbdlft.to_lft(cart(" + ".join(p.name for p in many), many))
    with pytest.raises(AnalysisError, match="depends on 1100 parameters"):
        mbdlft.realize([[" + ".join(p.name for p in numbered(1100))]], numbered(1100))


def test_those_that_it_does_not_depend_on_are_not_counted() -> None:
    many = numbered(1100, "m")
    ports = {f"port{k}": (p.name, 0, 0) for k, p in enumerate(many)}
    body = RigidBody(name="b", mass=2.0, inertia=Inertia(xx=1, yy=1, zz=1), ports=ports)
    scene = cart("1", many).model_copy(update={"bodies": (body,)})
    joint = scene.joints[0].model_copy(update={"child": "b"})
    model = mbdlft.to_lft(scene.model_copy(update={"joints": (joint,)}), search=0.0)
    assert (model.order, len(model.parameters)) == (0, 1100)


def test_products_of_seventy_with_a_search() -> None:
    """The box of monomials has 2^70 coefficients, and there are 54,740 triples."""
    many = numbered(70)
    model = mbdlft.realize([[products(many)]], many)
    assert model.certificate.order_bound == 70
    values = {p.name: 1.0 + 0.1 * (-1) ** k for k, p in enumerate(many)}
    expected = sum(values[p.name] * values[q.name] for p, q in pairwise(many))
    target(model.at(**values).D, np.array([[expected]]), CLOSED_FORM)


def test_looks_at_pairs_and_triples_are_counted() -> None:
    many = numbered(40)
    with precision(BITS):
        problem = problem_of_matrix(
            MatrixProblem(name="products", matrix=[[products(many)]], parameters=many)
        )
        (candidate,) = candidates(problem, problem.forms[:1])
        bound = JointBound(candidate.exact, exact_degrees(candidate.exact))
        before, work = lower_bound._reduced.cache_info().misses, Work(0.05)
        bound.of_all(work)
        assert work.is_over
        assert lower_bound._reduced.cache_info().misses - before < 0.1 * 1.5e10 / 5e6


def test_no_look_at_dependences_that_takes_more_than_is_left() -> None:
    a = LFT(np.zeros((2, 2)), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), (Block("p", 2),))
    assert independent(a, Work(1e-9)) is a
    assert independent(a, Work()).order == 1


def test_channels_of_many_points_are_those_of_few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(circles, "_NUMBERS", 100)
    random = np.random.default_rng(0)
    M11, M12 = 0.1 * random.standard_normal((6, 6)), random.standard_normal((6, 2))
    deltas = np.exp(1j * random.uniform(0.0, 6.0, (7, 6)))
    for k, found in enumerate(circles.channels_at(M11, M12, deltas)):
        target(found, np.linalg.solve(np.eye(6) - M11 * deltas[k], M12), CLOSED_FORM)
    assert circles.channels_at(M11, M12, deltas[:0]).shape == (0, 6, 2)
