"""Modelica models that are exported are read again to the same linear model."""

from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

import mbdlft
from mbdlft.base.errors import StructureError
from mbdlft.base.parameter import to_internal
from mbdlft.base.samples import random
from mbdlft.export import export_model
from mbdlft.export.matlab import TANGENT
from mbdlft.modelica import load_modelica, operating_point
from mbdlft.system import LFTModel, System
from tests.close import CLOSED_FORM, target
from tests.modelica import FLAT, ROOT


def of_scenario(name: str) -> System:
    return mbdlft.to_lft(mbdlft.load_scene(ROOT / "scenarios" / f"{name}.toml"), search=0.0, prove=0.0)


def of_one_name() -> System:
    p = mbdlft.Parameter("p", 2.0, percent=20)
    return mbdlft.realize([["-p", "p"], ["1", "p"]], [p], states=1, inputs=["j.v"], outputs=["j.v"])


def of_flat(name: str) -> LFTModel:
    dae, report = load_modelica(FLAT / f"{name}.mof")
    return mbdlft.linearize_dae(operating_point(dae, report), search=0.0, prove=0.0)


@pytest.mark.parametrize(
    "model",
    [
        pytest.param(lambda: of_flat("motor_drive"), id="motor"),
        pytest.param(lambda: of_flat("coupled_inertias"), id="inertias"),
        pytest.param(lambda: of_scenario("half_car"), id="half_car"),
        pytest.param(lambda: of_scenario("two_link_arm"), id="angles"),
        pytest.param(of_one_name, id="one name"),
    ],
)
def test_the_model_is_the_same_at_random_values(model: Callable[[], System], tmp_path: Path) -> None:
    made = model()
    (file,) = export_model(tmp_path / "back.mo", made)
    dae, report = load_modelica(file.rename(tmp_path / "back.mof"))
    again = mbdlft.linearize_dae(operating_point(dae, report), search=0.0, prove=0.0)
    values = random(made.parameters, 6, 4)
    written = {TANGENT[p.substitution] + p.name: to_internal(p, values[p.name]) for p in made.parameters}
    for a, b in zip(mbdlft.matrices_at(again, written), mbdlft.matrices_at(made, values), strict=True):
        target(a, b, CLOSED_FORM)


def test_the_compiler_reads_it_and_what_has_no_text_is_refused(tmp_path: Path) -> None:
    made = of_flat("motor_drive")
    (file,) = export_model(tmp_path / "model.mo", replace(made, name="model", description='a "b" \\'))
    if find_spec("rumoca") is not None:
        dae, report = load_modelica(file)
        again = mbdlft.linearize_dae(operating_point(dae, report), search=0.0, prove=0.0)
        target(mbdlft.matrices_at(again, {}).A, mbdlft.matrices_at(made, {}).A, CLOSED_FORM)
    form = mbdlft.delta_theta(load_modelica(FLAT / "pendulum.mof")[0], search=0.0, prove=0.0)
    with pytest.raises(StructureError, match=r"has nonlinear functions. Linearize it"):
        export_model(tmp_path / "form.mo", form)
    twice = replace(made, inputs=tuple(replace(s, name="w") for s in made.inputs))
    with pytest.raises(StructureError, match=r"clash: both become 'w'"):
        export_model(tmp_path / "twice.mo", twice)
