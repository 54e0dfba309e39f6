"""Values at many points are those of the function at each."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.batch.rows import source_of
from mbdlft.problem.sx import evaluation as many
from tests.close import exact, roundoff

SCENARIOS = Path(__file__).parents[2] / "scenarios"
COUNT = 3 * many.MANY


def operations() -> ca.Function:
    """All operations that have a program, results of two shapes, constants and zeros among them."""
    a, b = ca.SX.sym("a", 3), ca.SX.sym("b", 2)
    first = ca.vertcat(a[0] * b[0] - a[1], ca.sin(a[2]) / a[0], ca.sqrt(a[0] + 2.0) + ca.cos(b[1]))
    second = ca.SX.zeros(2, 3)
    second[0, 1] = -ca.fabs(a[2]) + a[1] ** 2
    second[1, 0] = 1.0 / (a[0] + 3.0) + 2.0 * b[1]
    second[1, 1] = 7.5
    second[1, 2] = b[0]
    return ca.Function("f", [a, b], [first, ca.densify(second)])


def points() -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(5)
    return generator.uniform(0.5, 2.0, (COUNT, 3)), generator.uniform(-1.0, 1.0, (COUNT, 2))


def called(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    each = [[part.full() for part in function.call([x[k] for x in arguments])] for k in range(COUNT)]
    return [np.stack(parts) for parts in zip(*each, strict=True)]


def test_vectors_are_calls() -> None:
    function, arguments = operations(), points()
    assert many.vectors(function) is not None
    found = many.evaluate_many(function, *arguments)
    for part, expected in zip(found, called(function, *arguments), strict=True):
        roundoff(part, expected)


def test_few_points_are_calls() -> None:
    function, arguments = operations(), points()
    few = many.evaluate_many(function, *(x[:5] for x in arguments))
    for part, expected in zip(few, called(function, *arguments), strict=True):
        exact(part, expected[:5])


@pytest.mark.parametrize("near", [1, 2**17])
def test_chunks_are_parts(near: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many, "_NEAR", near)
    function, arguments = operations(), points()
    whole = many.evaluate_many(function, *arguments)
    seen = 0
    for part, values in many.evaluate_in_chunks(function, *arguments):
        assert part.start == seen
        seen = part.stop
        for value, expected in zip(values, whole, strict=True):
            exact(value, expected[part])
    assert seen == COUNT


def test_an_operation_without_a_program_is_called() -> None:
    a = ca.SX.sym("a", 1)
    function = ca.Function("f", [a], [ca.atan(a)])
    assert many.vectors(function) is None
    x = np.linspace(0.0, 1.0, COUNT)[:, None]
    roundoff(many.evaluate_many(function, x)[0][:, 0], np.arctan(x))
    ((part, (values,)),) = many.evaluate_in_chunks(function, x)
    assert part == slice(0, COUNT)
    roundoff(values[:, 0], np.arctan(x))


def test_a_long_function_is_called(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many, "_LONGEST", 3)
    assert many.vectors(operations()) is None


@pytest.mark.parametrize("name", ["two_link_arm", "solar_arrays"])
def test_linearizations_are_those_of_calls(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where accelerations are imposed, which one equation alone gives."""
    source = source_of(mbdlft.load_scene(SCENARIOS / f"{name}.toml"))
    samples = mbdlft.random(source.parameters, many.MANY + 1, seed=2)
    at = np.stack([samples[p.name] for p in source.parameters], axis=-1)
    found = source.rows(at)
    monkeypatch.setattr(many, "MANY", len(at) + 1)
    for part, expected in zip(found, source.rows(at), strict=True):
        roundoff(part, expected)
