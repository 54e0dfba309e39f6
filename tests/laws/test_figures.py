"""What figures show is what the model says: bars of the orders, trimmed loads over a parameter."""

import math
from contextlib import nullcontext
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import mbdlft
from mbdlft import Angle, Parameter
from mbdlft.base.display import table
from mbdlft.show import save_orders, save_trims
from mbdlft.show.figures.figures import over_frequency
from mbdlft.show.figures.properties import orders_figure, trim_curves
from tests import kit
from tests.close import CLOSED_FORM, target
from tests.laws.test_report import read
from tests.seeds import some

_G = 9.81


def held_arm() -> mbdlft.LFTModel:
    """A link whose joint holds it at the angle theta from the vertical: m g L sin(theta)."""
    return mbdlft.to_lft(
        kit.scene(
            "arm",
            Parameter("m", 2.0, low=1.0, high=4.0, unit="kg"),
            Parameter("L", 0.8, low=0.6, high=1.2, unit="m"),
            Angle("theta", 30.0, low=-20.0, high=80.0),
            kit.body("link", "m", xx=0.1, center_of_mass=(0, 0, "-L")),
            kit.hinge("joint", "ground", "link", (1, 0, 0), position="theta"),
            gravity=(0, 0, -_G),
        ),
        search=0.0,
    )


def test_trim_over_an_angle_is_that_of_the_closed_form() -> None:
    model = held_arm()
    found = trim_curves(model, "theta")
    angle = np.radians(found.values)
    target((found.values[0], found.values[-1]), (-20.0, 80.0), CLOSED_FORM)
    torque = _G * np.sin(angle)
    target(found.nominal[:, 0], 1.6 * torque, CLOSED_FORM)
    largest, least = 4.0 * 1.2, 1.0 * 0.6  # of m L over the box
    above, below = angle > 0.01, angle < -0.01
    assert np.all(found.low <= found.nominal)
    assert np.all(found.nominal <= found.high)
    slack = 1.0 + CLOSED_FORM
    assert np.all(found.high[above, 0] <= slack * largest * torque[above])
    assert np.all(found.high[above, 0] >= 1.3 * 1.6 * torque[above])  # samples do spread
    assert np.all(found.low[above, 0] * slack >= least * torque[above])
    assert np.all(found.low[above, 0] <= 0.8 * 1.6 * torque[above])
    assert np.all(found.high[below, 0] * slack <= least * torque[below])


def test_bars_are_the_numbers_of_the_certificate() -> None:
    model = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
    (axes,) = orders_figure(model).axes
    before, reduced = axes.containers
    said = model.certificate
    assert tuple(bar.get_width() for bar in before) == said.raw_order
    assert tuple(bar.get_width() for bar in reduced) == said.order
    (lines,) = axes.collections
    assert tuple(path.vertices[0, 0] for path in lines.get_paths()) == said.lower_bound
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == list(model.parameters.names)
    assert [text.get_text() for text in axes.texts][3] == " 3, at least 2"  # m3


def test_what_cannot_be_drawn_is_an_error(tmp_path: Path) -> None:
    model, file = held_arm(), tmp_path / "figure.png"
    with pytest.raises(mbdlft.AnalysisError, match=r"unknown parameter 'thetaa'.*theta"):
        save_trims(file, model, "thetaa")
    passive = mbdlft.realize([["a"]], [Parameter("a", 1.0, percent=10)])
    with pytest.raises(mbdlft.AnalysisError, match="nothing holds its equilibrium"):
        save_trims(file, passive)
    plain = mbdlft.as_system(2.0)
    for save in (save_trims, save_orders):
        with pytest.raises(mbdlft.AnalysisError, match="model"):
            save(file, plain)
    with pytest.raises(mbdlft.AnalysisError, match="without parameters"):
        save_orders(file, mbdlft.realize([["2"]], []))
    assert not file.exists()
    save_trims(file, model)
    save_orders(tmp_path / "orders.svg", model)
    assert file.stat().st_size > 10_000
    assert math.isclose(model.trim.nominal[0], 1.6 * _G * 0.5, rel_tol=CLOSED_FORM)


def test_names_with_dollars_are_no_mathematics(tmp_path: Path) -> None:
    name = r"$\frac$ of 5 $ and 6 $"
    scene = kit.scene(
        name,
        Parameter("k", 2.0, percent=10, unit="N/m"),
        kit.point("bob", 1.0),
        kit.rail(name, "ground", "bob", (1, 0, 0), stiffness="k", damping=0.1),
    )
    model = mbdlft.to_lft(scene, search=0.0)
    for kind in ("singular_values", "bode", "step", "pole_map"):
        file = tmp_path / f"{kind}.svg"
        getattr(mbdlft.show, f"save_{kind}")(file, model)
        assert r"\frac" in file.read_text(encoding="utf-8")


def test_powers_of_ten_are_plain_text(tmp_path: Path) -> None:
    """Over several decades; over less than two the labels of matplotlib have more than powers."""
    axes = Figure().add_subplot()
    over_frequency(axes, 0.01, 2e12)
    label = axes.xaxis.get_major_formatter()
    assert [label(x) for x in (0.01, 1.0, 1e12)] == ["10\u207b\u00b2", "10\u2070", "10\u00b9\u00b2"]
    over_frequency(axes, 3.0, 20.0)
    figure = axes.figure
    figure.savefig(tmp_path / "short.png")
    shown = [text.get_text() for text in axes.get_xticklabels(which="minor")]
    assert sum(bool(text) for text in shown) > 3


KINDS = ("singular_values", "bode", "nyquist", "nichols", "step", "orders", "pole_map", "trims")


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Figures as they are written, laid out."""
    figures: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    return figures


@pytest.mark.parametrize(
    ("kind", "width"), some([("singular_values", None), *product(KINDS, [8.5])], product(KINDS, [None]))
)
def test_legends_and_labels_have_room(
    kind: str, width: float | None, tmp_path: Path, drawn: list[Figure]
) -> None:
    """No legend covers a panel, so none a curve, and no text is cut: boxes, as they are drawn."""
    with nullcontext() if width is None else mbdlft.show.for_paper(width):
        getattr(mbdlft.show, f"save_{kind}")(tmp_path / "f.png", held_arm())
    (figure,) = drawn
    panels = [axes for axes in figure.axes if axes.get_visible()]
    boxes = [axes.get_window_extent() for axes in panels]
    legends = [*figure.legends, *filter(None, (axes.get_legend() for axes in panels))]
    assert legends
    for legend in legends:
        assert not any(legend.get_window_extent().overlaps(box) for box in boxes)
    texts = [text for axes in panels for text in (axes.title, axes.xaxis.label, axes.yaxis.label)]
    for item in (*legends, *(text for text in texts if text.get_text())):
        box = item.get_window_extent()
        assert box.x0 >= 0.0
        assert box.y0 >= 0.0
        assert box.x1 <= figure.bbox.x1
        assert box.y1 <= figure.bbox.y1
    if width is not None:
        assert figure.get_size_inches()[0] == width / 2.54


def test_the_worst_gain_may_be_at_infinite_frequency(tmp_path: Path, drawn: list[Figure]) -> None:
    """10 s/(s + 1000 a) beside a resonance of 50 rad/s: as of an effort, 20 dB by the direct path."""
    a = Parameter("a", 1.0, percent=20)
    lag = ["-1000*a", "0", "0", "1"], ["0", "0", "1", "0"], ["0", "-2500", "-2", "1"]
    matrix = [*lag, ["-10000*a", "100", "0", "10"]]
    model = mbdlft.realize(matrix, [a], states=3, inputs=["u"], outputs=["y"], name="lead")
    mbdlft.show.save_singular_values(tmp_path / "f.png", model, worst={"a": 0.9})
    labels = [text.get_text() for legend in drawn[0].legends for text in legend.get_texts()]
    assert "worst case: 20.0 dB at infinite frequency" in labels


def test_loops_are_drawn_as_they_are(tmp_path: Path, drawn: list[Figure]) -> None:
    """k/(s + 1)^3: values and phases by the size of each point; peaks of closed loops by definition."""
    matrix = [["-1", "0", "0", "k"], ["1", "-1", "0", "0"], ["0", "1", "-1", "0"], ["0", "0", "1", "0"]]
    parameter = Parameter("k", 4.0, low=2.0, high=8.0)
    model = mbdlft.realize(matrix, [parameter], states=3, inputs=["u"], outputs=["y"])
    for save in (mbdlft.show.save_nyquist, mbdlft.show.save_nichols):
        save(tmp_path / "f.png", model, worst={"k": 8.0})
    curves = [{line.get_label(): line.get_xydata() for line in figure.axes[0].lines} for figure in drawn]
    at = {"worst case": 8.0, "nominal": 4.0}
    for label, k in at.items():
        x, y = curves[0][label].T
        omega = np.sqrt(np.cbrt((k / np.hypot(x, y)) ** 2) - 1.0)
        some = np.isfinite(omega) & (np.hypot(x, y) > 1e-3)
        values = k / (1.0 + 1j * omega[some]) ** 3
        target(x[some], values.real, CLOSED_FORM, 1.0)
        half = np.where(np.arange(len(x)) < len(x) // 2, 1.0, -1.0)  # then those of negative frequencies
        target(y[some], half[some] * values.imag, CLOSED_FORM, 1.0)
        phase, size = curves[1][label].T
        turned = -3.0 * np.degrees(np.arctan(np.sqrt(np.cbrt((k / 10 ** (size / 20.0)) ** 2) - 1.0)))
        seen = size > -40.0
        target(phase[seen], turned[seen], CLOSED_FORM, 100.0)
    phase, size = curves[1]["closed loop: 3 and 6 dB"].T
    loop = 10.0 ** (size / 20.0) * np.exp(1j * np.radians(phase))
    target(20.0 * np.log10(np.abs(loop / (1.0 + loop))), np.full(len(loop), 3.0), CLOSED_FORM)
    assert curves[1]["critical point"].tolist() == [[-180.0, 0.0]]


def test_a_width_for_print_is_checked_and_ends(tmp_path: Path, drawn: list[Figure]) -> None:
    with pytest.raises(mbdlft.AnalysisError, match="a width of 2 cm: expected 5 to 60"):
        mbdlft.show.for_paper(2.0).__enter__()
    with mbdlft.show.for_paper(8.5, fonts="latex"):
        mbdlft.show.save_orders(tmp_path / "f.png", held_arm())
    mbdlft.show.save_orders(tmp_path / "f.png", held_arm())
    assert [figure.get_size_inches()[0] for figure in drawn] == [8.5 / 2.54, 8.0]
    assert [figure.axes[0].title.get_fontfamily()[0] for figure in drawn] == ["cmr10", "sans-serif"]


# What notebooks show: the numbers of the object, and no text as markup.

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
