"""What notebooks show: the numbers of the object, and no text as markup."""

from dataclasses import replace
from pathlib import Path

import mbdlft
from mbdlft.base.display import table
from tests.laws.test_report import read

SCENARIOS = Path(__file__).parents[2] / "scenarios"


def cells(thing: object) -> dict[str, list[str]]:
    html = thing._repr_html_()  # type: ignore[attr-defined]
    return {row[0]: row for row in read(html).rows}


def test_scenes_models_and_bounds() -> None:
    scene = mbdlft.load_scene(SCENARIOS / "pendulum.toml")
    assert repr(scene) == "<Scene 'pendulum': 2 bodies, 2 joints, 2 parameters>"
    found = cells(scene)
    assert found["m"] == ["m", "2", "1.4", "2.6", "kg", "uncertain"]
    assert found["pivot"] == ["pivot", "revolute", "ground", "link"]
    model = mbdlft.to_lft(scene, search=0.0, prove=0.0)
    assert cells(model)["L"] == ["L", "0.8", "0.64", "0.96", "m", "2"]
    assert "order 3, minimal: proved" in model._repr_html_()
    smaller = replace(model.certificate, exact=False)
    assert "not exact" in replace(model, certificate=smaller)._repr_html_()
    bounds = mbdlft.worst_case_gain(model, "pivot.torque", "pivot.angle", work=2.0)
    rows = cells(bounds)
    for name, value in bounds.worst.items():
        assert rows[name][1] == f"{value:.6g}"
    assert "with a proof" in bounds._repr_html_()
    assert "no proof" in replace(bounds, proof=None)._repr_html_()


def test_texts_are_not_markup() -> None:
    evil = "<img src=x onerror=alert(1)>"
    scene = mbdlft.load_scene(SCENARIOS / "pendulum.toml").model_copy(update={"description": evil})
    model = replace(mbdlft.to_lft(scene, search=0.0, prove=0.0), description=evil)
    for thing in (scene, model):
        assert "<img" not in thing._repr_html_()
        assert "&lt;img" in thing._repr_html_()


def test_numbers_have_six_digits() -> None:
    assert "<td>1.23457</td><td>7</td>" in table(("a", "b"), [[1.23456789, 7]])


def test_a_gain_has_no_table() -> None:
    assert "<table>" not in mbdlft.state_space([], [], [], [[2.0]], name="gain")._repr_html_()


def test_parameter_has_its_range() -> None:
    html = mbdlft.Parameter("m", 2.0, percent=10, unit="kg", role="design")._repr_html_()
    for cell in ("m", "2", "1.8", "2.2", "kg", "design"):
        assert f"<td>{cell}</td>" in html
