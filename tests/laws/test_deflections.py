"""Loads of frames as the force method has them: a second moment multiplies axial deflections alone."""

import casadi as ca
import pytest

import mbdlft
from mbdlft import Parameter
from mbdlft.problem.deflections import with_scaled_deflections
from mbdlft.problem.relations import LinearModel
from tests import close
from tests.attack.frames import STEEL, Bar, Structure, scene_of

POST_AND_ARM = (Bar(-1, 0, 0, 0.0, ""), Bar(0, 1, 90, 1.2, "fixed"))


@pytest.mark.parametrize(
    ("names", "order"),
    [(("I", "h"), {"I": 24, "h": 95}), (("A", "I", "h"), {"A": 38, "I": 24, "h": 110})],
)
def test_second_moments_multiply_few_deflections(names: tuple[str, ...], order: dict[str, int]) -> None:
    """I 69 and h 139, or 141, with the bending deflections as they are."""
    values = {"h": 1.5, **STEEL}
    frame = Structure(POST_AND_ARM, 1, (1.0, -9.81, 2.0), (0.0, 0.0, 0.0), 0.0, values, names)
    model = mbdlft.to_lft(scene_of(frame), search=0.0, prove=0.0)
    assert {block.name: block.size for block in model.lft.blocks} == order


def _springs(low: float) -> LinearModel:
    """A force f on springs p, p/2 and 3 in a row, which are 1 longer together."""
    parameter = Parameter("p", 2.0, low=low, high=4.0)
    p, q, f, one = ca.SX.sym("p"), ca.SX.sym("q", 3), ca.SX.sym("f"), ca.SX.sym("one")
    residual = ca.vertcat(p * q[0] - f, p * q[1] - 2 * f, 3 * q[2] - f, ca.sum1(q) - one)
    return LinearModel(residual, ca.SX(f), ca.vertcat(q, f), one, p, (parameter,))


def test_loads_do_not_depend_on_how_deflections_are_scaled() -> None:
    """f = 1/(3/p + 1/3); the parameter multiplies two springs before, and one signal after."""
    (trim,) = with_scaled_deflections(_springs(1.0))
    assert [k for k in range(4) if ca.depends_on(trim.residual[k], trim.p)] == [3]
    for p in (1.0, 2.5, 4.0):
        at = ca.SX(ca.substitute(trim.residual, ca.vertcat(trim.p, trim.known), ca.DM([p, 1.0])))
        offset = ca.DM(ca.substitute(at, trim.unknown, ca.DM.zeros(4)))
        f = ca.solve(ca.DM(ca.jacobian(at, trim.unknown)), -offset)[3]
        close.roundoff(float(f), 1.0 / (3.0 / p + 1.0 / 3.0))


def test_parameters_that_may_be_zero_scale_nothing() -> None:
    """Deflections times such a parameter are not determined where it is zero."""
    assert with_scaled_deflections(_springs(-1.0)) == ()
