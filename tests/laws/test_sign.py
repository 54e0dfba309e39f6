"""Signs of functions in a box: what is proved is true, what is refuted has a point, the rest is open."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from mbdlft import Constant, Inertia, Parameter, PointMass, Revolute, RigidBody, Scene, SceneError
from mbdlft.base.expression import Number, evaluate
from mbdlft.exact import taylor
from mbdlft.exact.taylor import lowest, not_negative
from mbdlft.multibody.scene import checks
from mbdlft.multibody.scene.checks import check_positive
from tests.close import roundoff


def ball(center: np.ndarray, offset: float):
    """sum (x_k - c_k)^2 + offset"""

    def function(x: Mapping[str, Any]) -> Any:
        steps = [value - float(at) for value, at in zip(x.values(), center, strict=True)]
        return sum((step * step for step in steps[1:]), steps[0] * steps[0]) + offset

    return function


@pytest.mark.parametrize("seed", range(30))
def test_a_ball_inside_is_found(seed: int) -> None:
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 5))
    center, radius = random.uniform(-0.9, 0.9, count), 10.0 ** random.uniform(-3.0, -1.0)
    bounds = {f"x{k}": (-1.0, 1.0) for k in range(count)}
    found = not_negative(ball(center, -(radius**2)), bounds, boxes=4096)
    assert found.point is not None
    assert np.linalg.norm(np.array(list(found.point.values())) - center) < radius
    assert found.value < 0.0


@pytest.mark.parametrize("seed", range(30))
def test_what_stays_above_is_proved(seed: int) -> None:
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 5))
    center = random.uniform(-0.9, 0.9, count)
    bounds = {f"x{k}": (-1.0, 1.0) for k in range(count)}
    assert not_negative(ball(center, 0.01), bounds, boxes=4096).is_proved


@pytest.mark.parametrize("boxes", [0, 1, 3, 20])
def test_few_parts_leave_it_open(boxes: int) -> None:
    """And the open parts hold the zero."""
    center = np.array([0.3137, 0.7219])
    bounds = {"a": (0.0, 1.0), "b": (0.0, 1.0)}
    found = not_negative(ball(center, -1e-10), bounds, boxes=boxes)
    assert found.point is None
    assert not found.is_proved
    assert any(
        all(low <= at <= high for (low, high), at in zip(part, center, strict=True))
        for part in found.open_parts
    )


def test_a_zero_that_is_not_crossed_is_open_or_within_the_slack() -> None:
    square = ball(np.array([0.1]), 0.0)
    assert not_negative(square, {"x": (-1.0, 1.0)}, 1e-9).is_proved
    found = not_negative(lambda x: x["x"] - x["x"] * 1.0, {"x": (-1.0, 1.0)}, 1e-12)
    assert found.is_proved
    below = not_negative(lambda x: x["x"] * 0.0 - 1e-6, {"x": (-1.0, 1.0)}, 1e-7)
    assert below.point is not None


def test_a_pole_is_open() -> None:
    found = not_negative(lambda x: 1.0 / (x["x"] * x["x"]), {"x": (-1.0, 2.0)}, boxes=60)
    assert not found.is_proved


@pytest.mark.parametrize("variables", [1, 2, 5, 7])
def test_lowest_is_below(variables: int) -> None:
    random = np.random.default_rng(variables)
    space = taylor.space(variables, 2)
    c = random.standard_normal((len(space), 3))
    u = taylor.Taylor(space, c, np.array([0.0, 0.1, 1e-17]))
    for x in (random.uniform(-1.0, 1.0, (200, variables)), random.choice([-1.0, 1.0], (50, variables))):
        powers = np.prod(x[:, None, :] ** space.exponents, axis=2)
        assert np.all(powers @ c - u.r >= lowest(u))


RANGES = {"a": 0.5, "b": 0.5}
CONSTANTS = {
    "rho": Constant(value=1.0, unit="kg/m^2"),
    "a0": Constant(value=0.3137, unit="m"),
    "b0": Constant(value=0.7219, unit="m"),
    "e": Constant(value=0.01, unit="m"),
    "unit": Constant(value=1.0, unit="m^2"),
    "half": Constant(value=0.5, unit="m"),
}


def bob(mass: str, **inertia: Any) -> Scene:
    parameters = [Parameter(n, 0.5, low=0.0, high=1.0, unit="m") for n in "ab"]
    body = (
        RigidBody(name="bob", mass=mass, inertia=Inertia(**inertia))
        if inertia
        else PointMass(name="bob", mass=mass)
    )
    return Scene(
        name="disc",
        parameters=parameters,
        constants=CONSTANTS,
        bodies=[body],
        joints=[Revolute(name="s", parent="ground", child="bob", axis=(1, 0, 0), preload=0.0)],
    )


DISC = "rho*((a - a0)^2 + (b - b0)^2 {sign} e^2)"


@pytest.mark.parametrize(
    ("mass", "inertia", "message"),
    [
        (DISC.format(sign="-"), {}, "body 'bob': mass [kg] is negative in the range, at a = 0.3"),
        (
            "1",
            {"xx": DISC.format(sign="-") + "*unit"},
            "inertia.xx [kg m^2] about the center of mass is negative in the range, at a = 0.3",
        ),
        (
            "1",
            {"xx": "2", "yy": "1", "zz": "1 - unit*rho*e^2 + " + DISC.format(sign="-") + "*unit"},
            "inertia.yy + inertia.zz - inertia.xx [kg m^2] about the center of mass is negative",
        ),
        (
            "1",
            {"xx": "2", "yy": "2", "zz": "2", "xy": "1 - 0.999*" + DISC.format(sign="-") + "*unit"},
            "a minor of the second moments of mass that follow from the inertia is negative",
        ),
    ],
)
def test_what_fails_in_a_disc(mass: str, inertia: dict[str, str], message: str) -> None:
    with pytest.raises(SceneError, match=".*".join(map(_escaped, message.split("...")))):
        check_positive(bob(mass, **inertia))


def _escaped(text: str) -> str:
    return "".join(f"\\{c}" if c in "[].+^" else c for c in text)


@pytest.mark.parametrize(
    ("mass", "inertia"),
    [
        (DISC.format(sign="+"), {}),
        ("1", {"xx": DISC.format(sign="+") + "*unit"}),
        ("1", {"xx": 0.0, "yy": "rho*a^2*unit", "zz": "rho*a^2*unit"}),  # a rod: a minor is zero
        ("rho*a*b", {"xx": "rho*a*b*b^2/12", "yy": "rho*a*b*a^2/12", "zz": "rho*a*b*(a^2 + b^2)/12"}),
        ("rho*unit/(1 + a/half)", {"xx": "rho*unit*unit/(1 + a/half)"}),
    ],
)
def test_what_is_proved_everywhere(mass: str, inertia: dict[str, Any]) -> None:
    assert all(outcome.sign.is_proved for outcome in check_positive(bob(mass, **inertia)))


def test_what_is_open_lists_its_parts() -> None:
    mass = "rho*((a - a0)*(a - a0) + (b - b0)*(b - b0) + e^2)"
    (outcome,) = check_positive(bob(mass), boxes=2)
    assert outcome.sign.open_parts
    assert outcome.names == ("a", "b")


@pytest.mark.parametrize("seed", range(5))
def test_minors_are_those_of_the_second_moments(seed: int) -> None:
    random = np.random.default_rng(seed)
    J = random.standard_normal((3, 3))
    J = J + J.T + 5.0 * np.eye(3)
    entries = {a + b: Number(J[i, j]) for i, a in enumerate("xyz") for j, b in enumerate("xyz")}
    found = [float(evaluate(one, {})) for _, one, _ in checks._second_moments(entries)]
    P = np.trace(J) * np.eye(3) - 2.0 * J
    minors = [np.linalg.det(np.delete(np.delete(P, k, 0), k, 1)) for k in (2, 1, 0)]
    roundoff(np.array(found), np.array([*np.diag(P), *minors, np.linalg.det(P)]), scale=1e3)
