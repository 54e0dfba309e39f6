"""Laws of the shape functions of beams: integrals in fractions, exact statics, equal transfers."""

from collections.abc import Callable, Sequence
from fractions import Fraction

import flint
import numpy as np
import pytest

import mbdlft
from mbdlft.base.errors import AnalysisError
from mbdlft.multibody.body import Beam, beam_elements
from mbdlft.multibody.body.beam_elements import (
    LINEAR,
    ONE,
    Deformation,
    cross_products,
    moments,
    products,
    size,
    strain,
    values_at,
)
from tests import kit
from tests.close import CLOSED_FORM, TRUNCATED, roundoff, target
from tests.laws import elastic as scenes

Function = Callable[[Fraction], Fraction]
F = Fraction
# functions of x on one element, written down once more: w and ds t of each coordinate
HERMITE: list[tuple[Function, Function]] = [
    (lambda x: (1 - x) ** 2 * (1 + 2 * x), lambda x: 6 * x * (x - 1)),
    (lambda x: x * (1 - x) ** 2, lambda x: (1 - x) * (1 - 3 * x)),
    (lambda x: x * x * (3 - 2 * x), lambda x: 6 * x * (1 - x)),
    (lambda x: x * x * (x - 1), lambda x: x * (3 * x - 2)),
]
ZERO: Function = lambda x: F(0)  # noqa: E731
BUBBLES: list[Function] = [
    lambda x: x * (1 - x),
    lambda x: x * (1 - x) * (1 - 2 * x),
    lambda x: x * (1 - x) * (1 - 5 * x * (1 - x)),
]
SHEAR: list[tuple[Function, Function]] = [
    (lambda x: 1 - x, ZERO),
    (ZERO, lambda x: 1 - x),
    *((f, ZERO) for f in BUBBLES),
    *((ZERO, f) for f in BUBBLES[:2]),
    (lambda x: x, ZERO),
    (ZERO, lambda x: x),
]
POINTS = [F(k, 12) for k in range(13)]  # Newton-Cotes: exact up to degree 12


def solved(matrix: list[list[Fraction]], right: list[Fraction]) -> list[Fraction]:
    rows = [[*row, b] for row, b in zip(matrix, right, strict=True)]
    for k in range(len(rows)):
        pivot = next(i for i in range(k, len(rows)) if rows[i][k])
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [entry / rows[k][k] for entry in rows[k]]
        for i in range(len(rows)):
            if i != k:
                rows[i] = [a - rows[i][k] * b for a, b in zip(rows[i], rows[k], strict=True)]
    return [row[-1] for row in rows]


def interpolated(f: Function) -> list[Fraction]:
    """Coefficients of the polynomial f, of degree 12 or less."""
    return solved([[x**k for k in range(13)] for x in POINTS], [f(x) for x in POINTS])


def derivative(f: Function) -> Function:
    coefficients = interpolated(f)
    return lambda x: sum((k * c * x ** (k - 1) for k, c in enumerate(coefficients) if k), F(0))


WEIGHTS = solved([[x**k for x in POINTS] for k in range(13)], [F(1, k + 1) for k in range(13)])


def fields(shapes: Sequence[tuple[Function, Function]], n: int) -> dict[str, list[Function]]:
    """The fields of one element of n, as functions of x."""
    slopes, bends = ([derivative(shape[k]) for shape in shapes] for k in (0, 1))
    return {
        "displacement": [w for w, _ in shapes],
        "slope": [lambda x, f=f: n * f(x) for f in slopes],
        "turn": [lambda x, t=t: n * t(x) for _, t in shapes],
        "bend": [lambda x, f=f: n * n * f(x) for f in bends],
        "shear": [
            lambda x, f=f, t=t: n * (f(x) - t(x)) for f, (_, t) in zip(slopes, shapes, strict=True)
        ],
    }


def assembled(functions: list[Function], n: int, step: int, weight: Function) -> np.ndarray:
    """Integrals of weight(s) f_i f_j over a beam of n elements, without the clamped coordinates."""
    count = step * n + len(functions) - step
    total = np.full((count, count), F(0), dtype=object)
    values = [[f(x) for x in POINTS] for f in functions]
    for e in range(n):
        scale = [c * weight((e + x) / n) / n for c, x in zip(WEIGHTS, POINTS, strict=True)]
        for i, a in enumerate(values):
            for j, b in enumerate(values):
                terms = (c * p * q for c, p, q in zip(scale, a, b, strict=True))
                total[e * step + i, e * step + j] += sum(terms, F(0))
    return total[2:, 2:].astype(float)


CASES = [("cubic", HERMITE, 2), ("shear", SHEAR, 7)]


def test_integrals_are_exact() -> None:
    """Every entry is the exact integral, rounded once."""
    for functions, shapes, step in CASES:
        d = Deformation("bending_y", functions, 3)
        for what, own in fields(shapes, 3).items():
            for weight, f in ((ONE, lambda s: F(1)), ((F(1), F(-1)), lambda s: 1 - s)):
                found = products(d, what, weight)
                roundoff(found, assembled(own, 3, step, f))
                assert np.array_equal(found, found.T)


ALL = [
    Deformation("bending_y", "cubic", 3),
    Deformation("bending_y", "quintic", 3),
    Deformation("bending_y", "shear", 2),
    Deformation("bending_y", "cubic", 4, 5),
    Deformation("bending_y", "cubic", 4, 5, (1, 2)),
    Deformation("axial", "cubic", 3),
    Deformation("torsion", "cubic", 4, 3, (3,)),
]


@pytest.mark.parametrize("d", ALL)
def test_statics_are_exact(d: Deformation) -> None:
    """Unit force at the tip: s (elongation), s^2/2 - s^3/6, s more for shear; E I = k G A = L = 1."""
    bends = d.name.startswith("bending")
    K = products(d, strain(d)) + (products(d, "shear") if d.functions == "shear" else 0.0)
    q = np.linalg.solve(K, values_at(d, "displacement", d.elements))
    for node in range(1, d.elements + 1):
        s = node / d.elements
        expected = s**2 / 2 - s**3 / 6 if bends else s
        expected += s if d.functions == "shear" else 0.0
        roundoff(values_at(d, "displacement", node) @ q, expected, kappa=1e4)
        if bends:
            roundoff(values_at(d, "turn", node) @ q, s - s**2 / 2, kappa=1e4)
    # what moments say about the deflection, by another integral
    mean = 1 / 8 if bends else 1 / 2
    roundoff(moments(d, "displacement") @ q, mean + (0.5 if d.functions == "shear" else 0), kappa=1e4)


def modes_are_orthogonal() -> None:
    """X' M X = 1 and X' K X = diag(values) with more digits than a double; stations are shapes, too."""
    for d in ALL[3:5]:
        M, K = (beam_elements._raw(d, what, d, what, ONE, 0, None) for what in ("displacement", "bend"))
        X, values = beam_elements.exact_modes(M, K)
        with flint.ctx.workprec(1024):
            unit = X.transpose() * beam_elements._rational(M) * X
            for i in range(len(M)):
                for j in range(len(M)):
                    assert abs(unit[i, j] - int(i == j)) < flint.arb(2) ** -200
        roundoff(np.diag(products(d, "bend")), values)
        assert np.all(np.diff(values) > 0.0)
        assert size(d) == len(values)


def test_modes_are_orthogonal(monkeypatch: pytest.MonkeyPatch) -> None:
    modes_are_orthogonal()
    monkeypatch.setattr(beam_elements, "BITS", (64, 512))  # too few bits are seen
    modes_are_orthogonal()
    monkeypatch.setattr(beam_elements, "BITS", (64,))
    with pytest.raises(AnalysisError, match="64 bits do not tell them apart"):
        modes_are_orthogonal()


def test_a_station_feels_a_load_in_the_middle_exactly() -> None:
    """Half way along, a unit force bends the tip by 5/48 L^3/EI."""
    d = Deformation("bending_y", "cubic", 2, 4, (1,))
    q = values_at(d, "displacement", 1) / np.diag(products(d, "bend"))
    roundoff([values_at(d, "displacement", k) @ q for k in (1, 2)], [1 / 24, 5 / 48], kappa=1e4)


def test_polar_moment_of_a_section_is_a_weight() -> None:
    """int s N ds is the same by moments and by a product with the straight line s."""
    line = Deformation("axial", "cubic", 1, 1)  # its one mode is 3^(1/2) s
    d = Deformation("bending_y", "cubic", 1, 6)
    by_product = cross_products(line, "displacement", d, "displacement")[0] / np.sqrt(3.0)
    roundoff(np.abs(by_product), np.abs(moments(d, "displacement", LINEAR)), kappa=10.0)


def hub(**shapes: object) -> mbdlft.Scene:
    """A hub that turns freely, with a beam and a mass at its tip; length and modulus are parameters."""
    parameters = (
        mbdlft.Parameter("L", 1.0, percent=20, unit="m"),
        mbdlft.Parameter("E", 1e3, percent=20, unit="Pa"),
    )
    body = scenes.beam(length="L", modulus="E", deformations=("bending_y",), **shapes)
    return kit.scene(
        "hub",
        *parameters,
        kit.body("hub", 1.0, zz=2.0),
        body,
        kit.point("bob", 0.2),
        kit.hinge("turn", "ground", "hub", (0, 0, 1)),
        kit.weld("root", "hub", "beam"),
        kit.weld("end", "beam.tip", "bob"),
        mbdlft.Acceleration(name="a", port="bob"),
        inputs=("turn.torque",),
        outputs=("a.y", "turn.acceleration"),
    )


def test_modes_have_the_transfers_of_a_fine_mesh_with_fewer_repetitions() -> None:
    """Up to the third frequency (150 rad/s), at the nominal values and all corners."""
    fine, few = (
        mbdlft.to_lft(hub(**s), search=0.0)
        for s in ({"elements": 6, "shape_functions": "quintic"}, {"modes": 8})
    )
    coarse = mbdlft.to_lft(hub(elements=4), search=0.0)
    assert few.order <= coarse.order < fine.order
    values = mbdlft.corners(fine.parameters)
    omega = np.array([1.0, 30.0, 300.0])
    expected, found, poor = (
        mbdlft.frequency_response(model, values, omega) for model in (fine, few, coarse)
    )
    size = np.max(np.abs(expected), axis=(2, 3), keepdims=True)
    target(found / size, expected / size, TRUNCATED, 1.0)
    assert np.max(np.abs((poor - expected) / size)) > 1e4 * TRUNCATED


@pytest.mark.parametrize("modes", [2, 6])
def test_modes_keep_the_rigid_body(modes: int) -> None:
    """What moves with the hub at low frequencies is that of the undeformed beam."""
    model = mbdlft.to_lft(hub(modes=modes), search=0.0)
    inertia = 2.0 + 1.0 / 3.0 + 0.2
    slow = mbdlft.frequency_response(model, {}, np.array([1e-4]))[0, 0, 1, 0]
    target(slow.real, 1.0 / inertia, 1e3 * CLOSED_FORM)


def test_frequency_errors_are_those_of_the_beam() -> None:
    rows = mbdlft.frequency_errors(scenes.beam(elements=10, deformations=("bending_y",)))
    assert [(row.deformation, row.tip) for row in rows] == [
        ("bending_y", "free"),
        ("bending_y", "clamped"),
    ]
    d = Deformation("bending_y", "cubic", 10)
    squares = np.linalg.eigvals(np.linalg.solve(products(d, "displacement"), products(d, "bend")))
    first = np.sqrt(np.min(squares.real)) / 1.8751040687119611**2 - 1.0
    assert abs(rows[0].errors[0] - first) < 1e-9
    fine = mbdlft.frequency_errors(scenes.beam(modes=20, deformations=("bending_y", "axial")))
    for row in fine:
        assert np.max(np.abs(row.errors)) < 1e-9
    thick = scenes.beam(shear_coefficient=0.8, shear_modulus=1.0)
    assert mbdlft.frequency_errors(thick) == ()
    assert isinstance(thick, Beam)
