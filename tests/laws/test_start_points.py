"""Laws of linear models at start values that are no equilibrium, against slopes by hand."""

from dataclasses import replace

import numpy as np
import pytest

import mbdlft
from mbdlft.base.errors import SceneError, TrimError
from mbdlft.base.samples import random
from mbdlft.dae import DaeDraft, reduce_index, start_point
from mbdlft.dae.linear import trim_sizes, trimmed_points
from mbdlft.modelica import ModelicaTable, flat_model, operating_point, translate
from mbdlft.modelica.translation import notes_of_point
from mbdlft.system import LFTModel
from tests.close import CLOSED_FORM, target

START = ModelicaTable(point="start")
FALLING = """
model Falling
  parameter Real m(min=1, max=3) = 2;
  parameter Real c(min=5, max=9) = 6;
  Real s(start=0.5, fixed=true);
  Real v(start=0.25, fixed=true);
  input Real F(start=7);
  output Real a = der(v);
equation
  der(s) = v;
  m*(1 + s^2)*der(v) + c*s + v^3 = F;
end Falling;
"""


def linear(text: str, table: ModelicaTable = START) -> LFTModel:
    dae, report = translate(flat_model(text), table)
    return mbdlft.linearize_dae(operating_point(dae, report, table), search=0.0, prove=0.0)


def test_rates_of_the_start_are_in_the_slopes() -> None:
    model = linear(FALLING)
    points = {name: [model_value] for name, model_value in (("c", 8.0), ("m", 1.5))}
    for values in (points, random(model.parameters, 4, 3)):
        A, B, C, D = mbdlft.matrices_at(model, values)
        for k, (m, c) in enumerate(zip(values["m"], values["c"], strict=True)):
            s, v, inertia = 0.5, 0.25, m * 1.25
            rate = (7 - c * s - v**3) / inertia
            row = [-(c + 2 * m * s * rate) / inertia, -3 * v**2 / inertia]
            target(A[k], [[0, 1], row], CLOSED_FORM)
            target(C[k], [row], CLOSED_FORM)
            target(B[k], [[0], [1 / inertia]], CLOSED_FORM)
            target(D[k], [[1 / inertia]], CLOSED_FORM)


def test_initial_equations_give_states_that_depend_on_parameters() -> None:
    model = linear("""
    model Tank
      parameter Real k(min=1, max=3) = 2;
      Real x(start=3);
      Real y(start=1);
      input Real u(start=1);
      output Real z = x*y;
    initial equation
      k*x = 6;
    equation
      der(x) = u - x^2;
      der(y) = k*x^2 - y;
    end Tank;
    """)
    target(model.certificate.max_relative_error, 0.0, CLOSED_FORM, scale=1.0)
    (c,) = mbdlft.matrices_at(model, {"k": [1.25]}).C
    target(c, [[1.0, 6 / 1.25]], CLOSED_FORM)
    (a,) = mbdlft.matrices_at(model, {"k": [1.25]}).A
    target(a, [[-9.6, 0.0], [12.0, -1.0]], CLOSED_FORM)


def test_a_state_that_is_a_rate_has_the_start_of_its_variable() -> None:
    dae, report = translate(
        flat_model("""
        model Shafts
          Real phi1(start=0.2); Real phi2; Real w1(start=3); Real w2;
        equation
          w1 = der(phi1); w2 = der(phi2);
          2*der(w1) + der(w2) = -phi1 - w1^2;
          phi1 = 4*phi2;
        end Shafts;
        """)
    )
    at = operating_point(dae, report, replace(START, states=("phi1", "der(phi1)")))
    assert not at.at_rest
    target(
        np.array([at.nominal["phi1"], at.nominal["w1"], at.nominal["w2"]]), [0.2, 3.0, 0.75], CLOSED_FORM
    )
    target(np.array(at.nominal["der(w1)"]), -9.2 / 2.25, CLOSED_FORM)
    assert any("no equilibrium: der(" in note for note in notes_of_point(at))


def test_a_start_that_other_starts_overrule_is_said() -> None:
    text = """
    model Pendulum
      Real x(start=0.6); Real y; Real vx; Real vy; Real T;
    equation
      vx = der(x); vy = der(y);
      der(vx) = T*x; der(vy) = T*y - 9; x^2 + y^2 = 1;
    end Pendulum;
    """
    at = operating_point(*translate(flat_model(text)), START)
    assert "note: x is 1 and not its start 0.6, by" in notes_of_point(at)[-1]
    at = operating_point(*translate(flat_model(text.replace("Real y;", "Real y(start=-0.8);"))), START)
    target([at.nominal["x"], at.nominal["y"]], [0.6, -0.8], CLOSED_FORM)
    assert not any("not its start" in note for note in notes_of_point(at))


def test_what_is_given_replaces_starts_and_an_equilibrium_has_no_note() -> None:
    dae, report = translate(flat_model(FALLING))
    at = start_point(reduce_index(dae), {"s": 0.0, "v": 0.0, "F": 0.0})
    assert at.nominal["der(v)"] == 0.0
    assert notes_of_point(at) == []
    assert notes_of_point(operating_point(dae, report)) == []
    with pytest.raises(SceneError, match="free and moving are for an equilibrium"):
        operating_point(dae, report, ModelicaTable(point="start", free=("F",)))


def test_starts_that_contradict_the_equations_are_refused() -> None:
    text = FALLING.replace("der(s) = v;", "der(s) = v; s + b = 1;").replace(
        "input", "Real b(start=0, fixed=true); input"
    )
    with pytest.raises(TrimError, match=r"no consistent initial point was found; .* fix fewer of them"):
        linear(text)


def test_sizes_at_a_start_have_the_derivatives_among_the_unknowns() -> None:
    """c is zero, as its terms cancel; it has their size, and what is fixed has its own."""
    draft = DaeDraft("turned")
    k = draft.parameter(mbdlft.Parameter("k", 3.0, percent=20))
    v = draft.variable("v", start=2.0, fixed=True)
    w = draft.variable("w", start=1.0, fixed=True)
    a, b, c = (draft.variable(name) for name in "abc")
    draft.equation(draft.der(v), equals=k * v)
    draft.equation(draft.der(w), equals=-k * w)
    draft.equation(a, equals=draft.der(v))
    draft.equation(b, equals=draft.der(w))
    draft.equation(c, equals=0.5 * a + b)
    draft.output("c")
    at = start_point(reduce_index(draft.dae()))
    points = np.array([[3.0]])
    z = trimmed_points(at, points)
    made = trim_sizes(at, points, z)
    sizes = dict(zip((q.name for q in at.structure.quantities), made, strict=True))
    assert sizes["c"] >= 0.5 * sizes["a"] + sizes["b"] >= 6.0
    assert sizes["der(v)"] >= 12.0
    assert (sizes["v"], sizes["w"]) == (2.0, 1.0)
