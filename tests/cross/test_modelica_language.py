"""What a compiler leaves in flat models: loops, functions, records, modes, initial values."""

import os
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

import mbdlft
from mbdlft.base import Parameter
from mbdlft.base.errors import MbdlftError
from mbdlft.dae import DaeDraft
from mbdlft.modelica import ModelicaTable, flat_text, load_modelica, operating_point
from mbdlft.modelica.loading import ROOTS, compiled_model
from mbdlft.modelica.variables import read_values
from mbdlft.pipeline.dae_models import linearize_dae
from tests.close import MECHANISM, exact, roundoff, target
from tests.errors.table import refused
from tests.modelica import FLAT, LIBRARY, MODELS, SCENARIOS, table_of

pytest.importorskip("rumoca", reason="the compiler rumoca is not installed")


def matrices(tmp_path: Path, text: str, table: ModelicaTable | None = None) -> list[Any]:
    """A, B, C and D of the linear model of a model M."""
    file = tmp_path / "m.mo"
    file.write_text(text)
    dae, report = load_modelica(file, table, model="M", roots=[])
    model = linearize_dae(operating_point(dae, report), search=0.0, prove=0.0)
    return [np.asarray(part) for part in mbdlft.matrices_at(model, {})]


def gain(tmp_path: Path, declared: str, equations: str, around: str = "") -> float:
    """The gain from u to y of a model without states."""
    signals = "input Real u(start=2); output Real y;"
    text = f"{around}\nmodel M {signals}\n{declared}\nequation\n{equations}\nend M;"
    return float(matrices(tmp_path, text)[3].reshape(()))


def test_loops_that_are_not_written_out(tmp_path: Path) -> None:
    text = """model M
      parameter Integer n = 6; Real T[n](each start=0); input Real u;
    equation
      der(T[1]) = u - 2*T[1] + T[2];
      for i in 2:n-1 loop der(T[i]) = T[i-1] - 2*T[i] + T[i+1]; end for;
      der(T[n]) = T[n-1] - 2*T[n];
    end M;"""
    A = matrices(tmp_path, text)[0].reshape(6, 6)
    expected = 2.0 * np.cos(np.pi * np.arange(1, 7) / 7.0) - 2.0  # of a chain of six
    roundoff(np.sort(np.linalg.eigvals(A).real), np.sort(expected))


FUNCTIONS = """
package P
  record R Real T[2,2]; Real w; end R;
  function power input Real x; input Integer n; output Real y;
  algorithm
    y := 1;
    for i in 1:n loop y := y*x; end for;
  end power;
  function branches input Real x; output Real y; protected Real z[2];
  algorithm
    z[1] := x; z[2] := 0;
    if x > 1 then z[2] := 3*x; else z[1] := 5*x; end if;
    y := z[1] + z[2];
  end branches;
  function again input Real x; input Integer n; output Real y;
  algorithm
    if n > 0 then y := x*again(x, n - 1); else y := 1; end if;
  end again;
  function turned input Real a; output R r;
  algorithm
    r := R([cos(a), sin(a); -sin(a), cos(a)], 2*a);
  end turned;
  function several input Real x; output Real a; output Real b[2];
  algorithm
    a := 2*x; b := {x, 7*x};
  end several;
end P;
"""


@pytest.mark.parametrize(
    ("declared", "equations", "expected"),
    [
        ("", "y = P.power(u, 3);", 12.0),
        ("", "y = P.again(u, 3);", 12.0),
        ("", "y = P.branches(u);", 4.0),
        ("", "y = P.branches(u - 1.5);", 5.0),
        ("P.R r;", "r = P.turned(u - 2); y = r.T[1,2] + r.w;", 3.0),
        ("Real b[2] = {k*u for k in 3:4};", "y = sum(b);", 7.0),
        (
            "parameter Real a(fixed=false); parameter Real b[2](each fixed=false);\ninitial equation\n"
            "(a, b) = P.several(1.5);",
            "y = (a + b[2])*u;",
            13.5,
        ),
        (
            "parameter Real k(fixed=false);\ninitial equation\nk = 4;",
            "y = if initial() then 0 else k*u;",
            4.0,
        ),
        ("parameter Real k(fixed=false);\ninitial algorithm\nk := 6;", "y = k*u;", 6.0),
        ("Boolean b; Real x;", "b = u > 1; x = if b then 2*u else 3*u; y = x;", 2.0),
        ("Boolean b;", "b = u > 1 or u > 2; y = if b then 2*u else 3*u;", 2.0),
        ("Boolean b; Real x;", "b = u > 3; x = if b then 2*u else 3*u; y = x;", 3.0),
        ("Boolean a; Boolean b;", "b = not a; a = u > 1; y = if b then 2*u else 9*u;", 9.0),
        ("Boolean b;", "b = time > 1; y = if b then 2*u else 8*u;", 8.0),
        ("Integer k(start=3, fixed=true);", "when u > 5 then k = pre(k) + 1; end when; y = k*u;", 3.0),
        ("", "y = mod(7, 4)*u;", 3.0),
        ("Real a; Real b[2];", "(a, b) = P.several(u); y = a*b[2];", 56.0),
        ("Real a;", "(a) = P.several(u); y = a;", 2.0),
        ("", "y = product({2, u, 3})*product(fill(1, 0));", 6.0),
        ("", "y = sum(linspace(u, 3*u, 5));", 10.0),
    ],
)
def test_gains(tmp_path: Path, declared: str, equations: str, expected: float) -> None:
    roundoff(gain(tmp_path, declared, equations, FUNCTIONS), expected)


def test_a_mode_is_that_of_the_equilibrium_and_not_of_the_start(tmp_path: Path) -> None:
    text = """model M
      input Real u(start=4); output Real y; Real x(start=0); Boolean open(start=false);
    equation
      der(x) = u - (if open then 2 else 1)*x;
      open = x > 1;
      y = x;
    end M;"""
    roundoff(matrices(tmp_path, text)[0].reshape(()), -2.0)


def test_the_point_of_a_table_is_that_of_its_report(tmp_path: Path) -> None:
    """Modes are those of this point."""
    file = tmp_path / "m.mo"
    file.write_text("""model M
      input Real u; output Real y; Boolean b;
    equation
      b = u > 3; y = (if b then 2 else 7)*u;
    end M;""")
    dae, report = load_modelica(file, ModelicaTable(at={"u": 4.0}))
    assert float(operating_point(dae, report).nominal["y"]) == 8.0
    with pytest.raises(mbdlft.TrimError, match="is 0 at this equilibrium, and 1 in the equations"):
        operating_point(dae, report, ModelicaTable())


def test_files_of_a_folder_are_read(tmp_path: Path) -> None:
    model = "model M input Real u; output Real y = {}*u; end M;"
    for name, factor in (("m", 2), ("old", 3)):
        (tmp_path / f"{name}.mo").write_text(model.format(factor))
    with pytest.raises(mbdlft.SceneError, match=r"'M' is in m\.mo, old\.mo, and it reads all"):
        load_modelica(tmp_path / "m.mo")
    (tmp_path / "old.mo").unlink()
    with pytest.raises(mbdlft.SceneError, match=r"m\.mo: unknown model 'N'\. Existing: M\."):
        load_modelica(tmp_path / "m.mo", model="N")


def test_a_delay_is_a_pade_approximation_of_the_order_that_is_asked_for(tmp_path: Path) -> None:
    text = "model M input Real u; output Real y; equation y = 3*delay(u, 0.5); end M;"
    A, B, C, D = matrices(tmp_path, text, ModelicaTable(delay=2))
    for s in (0.3j, 1.0 + 2.0j):
        got = C @ np.linalg.solve(s * np.eye(2) - A.reshape(2, 2), B.reshape(2, 1)) + D
        x = 0.5 * s  # the table of Pade: (12 - 6 x + x^2)/(12 + 6 x + x^2)
        roundoff(got.reshape(()), 3.0 * (12.0 - 6.0 * x + x**2) / (12.0 + 6.0 * x + x**2))


def test_unknown_parameters_of_several_initial_equations(tmp_path: Path) -> None:
    declared = """parameter Real q = 6;
      parameter Real a(fixed=false, start=1); parameter Real b(fixed=false, start=3);
    initial equation
      a*b = q; a = 5 - b;"""
    roundoff(gain(tmp_path, declared, "y = (10*a + b)*u;"), 23.0)


test_what_has_no_one_linear_model_is_refused = refused(
    r"""
> gain(tmp_path, {}) => SceneError:
"discrete Real d;", "when sample(0, 0.1) then d = u; end when; y = d;" => the event 'when' … (d)
"Boolean b; Real x;", "b = x > 1; der(x) = (if b then 0.5 else u) - x; y = x;" => the modes b have no
"", "y = delay(u, 0.5);" => delay() has no linear model
"E e; type E = enumeration(a, b);", "e = if u > 1 then E.a else E.b; y = if e == E.a then u else 3*u;"
  => signals choose between the text 'a' and the text 'b', which are no numbers
> gain(tmp_path, {}) => TrimError:
"Boolean b;", "b = u > 2; y = if b then 2*u else 3*u;" => line 5: b = u > 2: jumps … where 2 < u
"Integer k(start=3);", "when u > 2 then k = 4; end when; y = k*u;" => the event at u > 2: jumps from
"Integer k(start=3); parameter Real a(min=1, max=4)=3;", "when a*u > 5 then k = 4; end when; y = k*u;"
  => NotRationalError: the event at (a * u) > 5: … changes its branch inside of the range of a
"""
)


PASSED_ON = """
package P
  record R Real r = 1; end R;
  model Part parameter Real c = 1; parameter R data; Real y;
  equation y = c*data.r; end Part;
  model Whole parameter Real c = 2; parameter R data; Part part(c=c, data=data); end Whole;
  model Inner extends Part(c=7); end Inner;
  model Outer extends Inner; Part part(c=c); Inner own; end Outer;
  model Choice replaceable Whole w(c=4); end Choice;
  model More extends Whole; Part more(c=c); end More;
  model Wide extends Choice(w(c=8)); end Wide;
end P;
"""
WHOLE = """
model M
  P.Wide k; parameter P.R r(r=5); P.Whole a(c=3); P.Whole b[2](each c=-3); P.Whole d(data=r);
  P.Outer e; P.Outer f(c=6, own.c=6); P.Choice g(redeclare P.More w), h(w(c=2^2));
end M;
"""


@pytest.mark.parametrize(
    ("parameter", "followers"),
    [
        ("a.c", "a.part.c"),
        ("b[1].c", "b[1].part.c"),
        ("b[2].c", "b[2].part.c"),
        ("r.r", "d.data.r d.part.data.r"),
        ("e.c", "e.part.c"),
        ("e.own.c", ""),
        ("f.c", "f.part.c"),
        ("f.own.c", ""),
        ("g.w.c", "g.w.part.c g.w.more.c"),
        ("h.w.c", "h.w.part.c"),
        ("k.w.c", "k.w.part.c"),
    ],
)
def test_a_parameter_that_is_passed_on_has_one_value(
    tmp_path: Path, parameter: str, followers: str
) -> None:
    """The compiler hands on the number of `c` where a component has the modification `c=c`."""
    (tmp_path / "P.mo").write_text(PASSED_ON)
    file = tmp_path / "m.mo"  # it declares no number of its own
    file.write_text(WHOLE)
    flat = compiled_model(file, "M", [])
    assert not flat.fixed
    numbers = read_values(flat, ModelicaTable(), lambda d: d.name).values
    changed = read_values(flat, ModelicaTable(values={parameter: 99.0}), lambda d: d.name).values
    assert {name for name in changed if changed[name] != numbers[name]} == {parameter, *followers.split()}


# Models with components, flattened by the compiler rumoca: the flat texts of the tests are those.

pytest.importorskip("rumoca", reason="the compiler rumoca is not installed")


def same(name: str, file: Path, model: str | None = None) -> None:
    text = (FLAT / f"{name}.mof").read_text(encoding="utf-8")
    assert flat_text(compiled_model(file, model, roots=[])) == text
    table = table_of(name)
    compiled, report = load_modelica(file, table, model=model, roots=[])
    flat, flat_report = load_modelica(FLAT / f"{name}.mof", table)
    assert [str(e.residual) for e in compiled.equations] == [str(e.residual) for e in flat.equations]
    assert compiled.parameters == flat.parameters
    assert report == flat_report
    assert all(e.line for e in compiled.equations)
    for a, b in zip(compiled.variables, flat.variables, strict=True):
        fields = ("name", "unit", "start", "fixed", "nominal", "minimum", "maximum", "comment")
        assert [getattr(a, key) for key in fields] == [getattr(b, key) for key in fields]


@pytest.mark.parametrize("file", SCENARIOS, ids=lambda file: file.stem)
def test_scenarios(file: Path) -> None:
    same(file.stem, file)


@pytest.mark.parametrize("name", MODELS)
def test_models_of_the_library(name: str) -> None:
    same(name, LIBRARY, f"Components.Examples.{MODELS[name]}")


def test_which_model_is_asked_for() -> None:
    with pytest.raises(MbdlftError, match=r"Candidates: .*Choose one: --model NAME, or model=NAME"):
        load_modelica(LIBRARY, roots=[])


def test_lines_and_annotations_are_those_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "two.mo"
    file.write_text(
        "package Two\n  model Part\n    parameter Real k = 1;\n    Real x;\n  equation\n"
        "    der(x) = -k*x;\n  end Part;\n  model All\n"
        '    parameter Real k = 2.50e0 annotation(Dialog(tab=1), mbdlft(percent=10, role="design"));\n'
        "    Part first(k=k), second(k=2*k);\n  end All;\nend Two;\n"
    )
    dae, _ = load_modelica(file, model="Two.All", roots=[])
    assert [(e.name, e.line) for e in dae.equations] == [
        ("der(first.x) = -(first.k * first.x)", 6),
        ("der(second.x) = -(second.k * second.x)", 6),
    ]
    assert [(p.name, p.low, p.role) for p in dae.parameters] == [("k", 2.25, "design")]
    assert "2.50e0" in dae.text


def test_folders_of_the_environment_are_libraries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = tmp_path / "libraries" / "Small"
    library.mkdir(parents=True)
    (library / "package.mo").write_text("package Small\nend Small;\n")
    (library / "Lag.mo").write_text(
        "within Small;\nmodel Lag\n  parameter Real T = 1;\n  Real y;\nequation\n"
        "  T*der(y) = 1 - y;\nend Lag;\n"
    )
    file = tmp_path / "m.mo"
    file.write_text("model M\n  Small.Lag lag(T=3);\nend M;\n")
    monkeypatch.setenv(ROOTS, str(tmp_path / "libraries"))
    dae, _ = load_modelica(file)
    assert [(e.name, e.line) for e in dae.equations] == [("lag.T * der(lag.y) = 1 - lag.y", 6)]


def name_of_form(file: Path, model: str) -> str:
    """The name of the Delta-Theta form of a model, or what it is refused with."""
    try:
        dae, _ = load_modelica(file, model=model)
        return mbdlft.delta_theta(mbdlft.reduce_index(dae), search=0.0).name
    except MbdlftError as error:
        return str(error)


def test_a_model_of_a_file_becomes_a_form(tmp_path: Path) -> None:
    file = tmp_path / "original.mo"
    file.write_text("model Lag\n  Real y;\nequation\n  der(y) = 1 - y^3;\nend Lag;\n")
    assert name_of_form(file, "Lag") == "Lag"
    file.write_text("model Lag\n  Real y;\nequation\n  0 = 1;\nend Lag;\n")
    assert "Lag" in name_of_form(file, "Lag")


ORIGINALS = [
    "Mechanics.Rotational.Examples.First",
    "Mechanics.Translational.Examples.Oscillator",
    "Mechanics.Translational.Examples.Accelerate",
    "Electrical.Analog.Examples.CauerLowPassAnalog",
    "Electrical.Analog.Examples.ChuaCircuit",
    "Thermal.HeatTransfer.Examples.TwoMasses",
    "Electrical.Machines.Examples.DCMachines.DCPM_Start",
    "Mechanics.MultiBody.Examples.Elementary.Pendulum",
]


def library() -> bool:
    folders = os.environ.get(ROOTS, "").split(os.pathsep)
    return any((Path(folder) / "Modelica" / "package.mo").exists() for folder in folders if folder)


@pytest.mark.long
@pytest.mark.skipif(not library(), reason=f"the Modelica Standard Library is not in {ROOTS}")
@pytest.mark.parametrize("name", ORIGINALS)
def test_originals_are_forms_or_refused_by_name(name: str, tmp_path: Path) -> None:
    file = tmp_path / "original.mo"
    file.write_text(f"model Original\n  extends Modelica.{name};\nend Original;\n")
    found = name_of_form(file, "Original")
    assert "Original" in found or "original.mo" in found


# Equations and a scene in one loop.


def test_a_motor_of_equations_drives_a_scene() -> None:
    """The scene's joint and the motor's shaft share an uncertain inertia's parameter and a signal."""
    arm = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
    shared = arm.parameters["m1"]
    d = DaeDraft("motor")
    m1, R = d.parameter(shared), d.parameter(Parameter("R", 0.5, percent=20, unit="Ohm"))
    v, i, torque = d.input("v", "V"), d.variable("i", "A"), d.variable("torque", "N m")
    d.equation(d.number(0.01) * d.der(i), "winding", equals=v - R * i)
    # a brake resistance in proportion to the mass that is moved
    d.equation(torque, "gear", equals=2 * i * (1 + m1 / d.number(10.0)))
    d.output("torque")
    motor = linearize_dae(d.dae())
    both = mbdlft.connect(
        [arm, motor],
        [["shoulder.torque", "torque"]],
        inputs=["v", "elbow.torque"],
        outputs=["shoulder.angle"],
    )
    exact(both.parameters.names, sorted({*arm.parameters.names, "R"}))
    values = {"m1": 1.1 * shared.nominal, "R": 0.55}
    found = both.at(**values)
    parts = arm.at(m1=values["m1"]), motor.at(**values)
    assert isinstance(found, control.StateSpace)
    for w in (0.5, 5.0):
        expected = parts[0](1j * w)[0, 0] * np.ravel(parts[1](1j * w))[0]
        target(found(1j * w)[0, 0], expected, MECHANISM)
