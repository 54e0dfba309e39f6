"""Each operation of a tape of relations, against the values that CasADi gives."""

import casadi as ca
import numpy as np
import pytest

from mbdlft import Parameter
from mbdlft.base.parameter import to_delta
from mbdlft.lft.sampling import evaluate
from mbdlft.problem.relations import LinearModel
from tests.close import roundoff
from tests.extracted import extracted

X, Z, P = ca.SX.sym("x"), ca.SX.sym("z"), ca.SX.sym("p")
SUM = P * P + 3.0
EXPRESSIONS = {
    "sum": X + Z,
    "difference": X - P * Z,
    "twice": 2.0 * (X + P * Z),
    "negative": -(P * X),
    "times a number": 0.7 * X,
    "over a number": (X + P * Z) / 7.0,
    "over a sum": X / SUM,
    "reciprocal": (1.0 / SUM) * X,
    "number over a sum": (5.0 / SUM) * X - Z / (SUM / 2.0),
    "square": P**2 * X,
    "nested": P * (X + P * (Z - P * X)),
    "coefficient over a coefficient": ((P - 4.0) / (P + 2.0)) * X,
}


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_operation(name: str) -> None:
    parameter = Parameter("p", 1.0, 0.5, 2.0)
    residual = EXPRESSIONS[name]
    function = ca.Function("relation", [X, Z, P], [residual])
    lft = extracted(LinearModel(residual, ca.SX(0, 1), X, Z, P, (parameter,)))
    points = np.linspace(0.5, 2.0, 7)
    found = evaluate(lft, {"p": to_delta(parameter, points)})
    expected = [[[float(function(*unit, p)) for unit in ((1, 0), (0, 1))]] for p in points]
    roundoff(found, expected, kappa=10.0)
