"""The figure of a tuning shows what the tuning says: its goals, poles and gains."""

from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from html import escape
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import mbdlft
from mbdlft.base.errors import AnalysisError
from mbdlft.show import model_report, save_tuning_figure
from mbdlft.show.figures.tuning import _draw_poles, tuning_figure
from mbdlft.synthesis import gain_goal, pole_goal, save_tuning, scheduled, tunable_gain, tune
from tests.close import CLOSED_FORM, FITTED, target

A = mbdlft.Parameter("a", 50.0, low=40.0, high=60.0)
PLANT = mbdlft.realize(
    [["a", "1"], ["1", "0"]], [A], states=1, inputs=["f"], outputs=["x"], name="P", search=0.0
)
LOOP = {"f": "-v", "e": ["x", "n"]}


def curves(axes: Axes) -> dict[str, list[np.ndarray]]:
    """Heights of lines by label; those without one under the label before them."""
    found: dict[str, list[np.ndarray]] = {}
    name = ""
    for line in axes.lines:
        label = str(line.get_label())
        name = name if label.startswith("_") else label
        found.setdefault(name, []).append(np.asarray(line.get_ydata()))
    return found


@cache
def tuned() -> mbdlft.Tuning:
    """x' = a x - k(a) (x + n), k = k0 + k1 delta: from n to v, k s/(s + k - a)."""
    K = scheduled(tunable_gain("K", "e", "v", initial={"D[1,1]": 120.0}), [A])
    return tune([PLANT, K], [gain_goal("n", "v", limit=100.0), pole_goal(decay=5.0)], LOOP, starts=1)


def test_the_report_of_a_controller_has_its_goals(tmp_path: Path) -> None:
    made, archive = tuned(), tmp_path / "made.h5"
    save_tuning(archive, made)
    html = model_report(mbdlft.load(archive, "K"), archive).html
    for reached in made.goals:
        assert escape(reached.found) in html
    assert "A goal of K: n to v, limit 100: nominal, samples, the worst case, and the bound" in html
    assert html.count('<span class="yes">proved</span>') == len(made.goals)
    plain = model_report(PLANT).html
    assert "tuned for" not in plain


def test_the_report_of_a_controller_believes_no_proof_of_its_file() -> None:
    forged = "".join(f"\n{r}, proved <= 0.001 for all values\nproved: all" for r in tuned().goals)
    html = model_report(replace(tuned().controllers[0], description=f"tuned:{forged}")).html
    assert html.count("worst found") == len(tuned().goals)
    assert "proved" not in html.partition("tuned for")[2].partition("</ul>")[0]


def test_panels_show_the_values_of_a_tuning(tmp_path: Path) -> None:
    made = tuned()
    figure = tuning_figure(made)
    goals, steps, poles, schedule = figure.axes
    shown = curves(goals)
    largest = max(np.max(curve) for curve in shown["n to v"][: len(made.points)])
    target([largest], [made.goals[0].tuned], FITTED * 1e3)
    target(shown["n to v"][-1], 2 * [made.goals[0].proved], CLOSED_FORM)
    assert set(shown) == {"n to v", "limit"}
    # the step of n to v begins with k, which is the largest value
    (label,) = curves(steps)
    first = [curve[0] for curve in curves(steps)[label]]
    k = [
        made.values["K.D[1,1]"] + made.values["K.D[1,1]*a"] * (p["a"] - 50.0) / 10.0 for p in made.points
    ]
    size = max(k)
    target(np.sort(first), np.sort(np.array(k) / size), 1e-6)
    nominal = next(line for line in poles.lines if line.get_label() == "nominal")
    target(np.asarray(nominal.get_xdata()), [50.0 - made.values["K.D[1,1]"]], 1e-6)
    assert all(np.max(np.asarray(line.get_xdata())[:1]) <= 0.0 for line in poles.lines)
    ends = next(iter(curves(schedule).values()))[0][[0, -1]]
    both = np.array([-1.0, 1.0]) * made.values["K.D[1,1]*a"] + made.values["K.D[1,1]"]
    target(ends, both, 1e-9)
    save_tuning_figure(tmp_path / "made.png", made)
    assert (tmp_path / "made.png").stat().st_size > 10_000
    with pytest.raises(AnalysisError, match="expected the ending"):
        save_tuning_figure(tmp_path / "made.txt", made)


@pytest.mark.parametrize("width", [None, 8.5, 17.0])
def test_legends_of_a_tuning_cover_no_panel(
    width: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither a curve nor a label, and none is cut: boxes, as they are drawn."""
    figures: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    with nullcontext() if width is None else mbdlft.show.for_paper(width):
        save_tuning_figure(tmp_path / "made.png", tuned())
    (figure,) = figures
    figure.canvas.draw()
    boxes = [box for axes in figure.axes for box in (axes.bbox, axes.xaxis.label.get_window_extent())]
    for legend in filter(None, (axes.get_legend() for axes in figure.axes)):
        box = legend.get_window_extent()
        assert not any(box.overlaps(other) for other in boxes)
        assert 0.0 <= box.x0 <= box.x1 <= figure.bbox.x1
        assert box.y0 >= 0.0


def test_ticks_of_poles_are_plain_numbers() -> None:
    """An axis inside of the linear part has even ticks, not its ends, such as 7.11 times 10^1."""
    A = np.diag([-3.0, -71.1, -4.0, -0.5, -0.5])
    A[3:, 3:] += 0.4 * np.array([[0.0, 1.0], [-1.0, 0.0]])
    loop = mbdlft.state_space(A, np.ones((5, 1)), np.ones((1, 5)), [[0.0]])
    figure = Figure()
    axes = figure.subplots()
    _draw_poles(axes, SimpleNamespace(loop=loop, points=({},)), 0)
    figure.canvas.draw()
    assert (axes.get_xscale(), axes.get_yscale()) == ("symlog", "linear")
    assert not any("$" in tick.get_text() for tick in axes.get_xticklabels() + axes.get_yticklabels())
