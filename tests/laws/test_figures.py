"""What figures show is what the model says: bars of the orders, trimmed loads over a parameter."""

import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import mbdlft
from mbdlft import Angle, Inertia, Parameter, Revolute, RigidBody, Scene
from mbdlft.show import save_orders, save_trims
from mbdlft.show.figures.figures import over_frequency
from mbdlft.show.figures.properties import orders_figure, trim_curves
from tests.close import CLOSED_FORM, target

_G = 9.81


def held_arm() -> mbdlft.LFTModel:
    """A link whose joint holds it at the angle theta from the vertical: m g L sin(theta)."""
    return mbdlft.to_lft(
        Scene(
            name="arm",
            gravity=(0, 0, -_G),
            parameters=[
                Parameter("m", 2.0, low=1.0, high=4.0, unit="kg"),
                Parameter("L", 0.8, low=0.6, high=1.2, unit="m"),
                Angle("theta", 30.0, low=-20.0, high=80.0),
            ],
            bodies=[
                RigidBody(name="link", mass="m", center_of_mass=(0, 0, "-L"), inertia=Inertia(xx=0.1))
            ],
            joints=[
                Revolute(name="joint", parent="ground", child="link", axis=(1, 0, 0), position="theta")
            ],
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
    scene = mbdlft.Scene(
        name=name,
        parameters=[Parameter("k", 2.0, percent=10, unit="N/m")],
        bodies=[mbdlft.PointMass(name="bob", mass=1.0)],
        joints=[
            mbdlft.Prismatic(
                name=name, parent="ground", child="bob", axis=(1, 0, 0), stiffness="k", damping=0.1
            )
        ],
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


@pytest.mark.parametrize("kind", ["singular_values", "bode", "step", "orders", "pole_map"])
def test_no_legend_is_over_a_panel(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So none covers a curve: boxes of legends and panels, as they are drawn."""
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    getattr(mbdlft.show, f"save_{kind}")(tmp_path / "f.png", held_arm())
    (figure,) = drawn
    boxes = [axes.get_window_extent() for axes in figure.axes if axes.get_visible()]
    legends = [*figure.legends, *filter(None, (axes.get_legend() for axes in figure.axes))]
    assert legends
    for legend in legends:
        assert not any(legend.get_window_extent().overlaps(box) for box in boxes)
