"""Models with components, flattened by the compiler rumoca: the flat texts of the tests are those."""

import os
from pathlib import Path

import pytest

import mbdlft
from mbdlft.base.errors import MbdlftError
from mbdlft.modelica import flat_text, load_modelica
from mbdlft.modelica.loading import ROOTS, compiled_model
from tests.modelica import FLAT, LIBRARY, MODELS, SCENARIOS, table_of

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
