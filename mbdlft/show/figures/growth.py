"""How a worst case grows with the box of the parameters: bounds as steps."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.lft.lft import LFT
from mbdlft.robust.evidence import Bounds
from mbdlft.robust.gain import worst_case_gain
from mbdlft.robust.worst import worst_case
from mbdlft.show.figures.figures import COLORS, WORST, check_figure, write_figure
from mbdlft.system.model import System

_SIZES = 12
_DECADE = 10.0  # a larger range of values is drawn in logarithms
_IS_LOWER = ("smallest damping", "smallest disk margin")  # what is proved is the lower bound


def save_growth(
    path: str | Path,
    model: System,
    what: str = "gain",
    inputs: Any = slice(None),
    outputs: Any = slice(None),
    *,
    sizes: Sequence[float] | None = None,
    margin: Bounds | None = None,
    gap: float = 0.02,
    work: float = 10.0,
    leave_out: Sequence[str] = (),
) -> None:
    """Draw the worst case over boxes of growing size.

    What is proved for a box holds for all smaller ones, and what is reached in it for all larger ones: so
    bounds are steps, and true between the sizes, too.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : System or LFTModel
    what : {"gain", "real part", "damping", "disk margin"}
    inputs, outputs : signals of the transfer, as for `worst_case_gain`
    sizes : sequence of float, rising, optional
        Multiples of the declared ranges; 12 up to 1, or up to the margin, by default.
    margin : Bounds, optional
        Of `robust_stability`, drawn as lines.
    gap, work, leave_out
        As for `worst_case_gain`, for each size.

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, sizes do not rise from above 0, or
        as `worst_case`.
    """
    check_figure(path)
    end = 0.98 * margin.lower if margin is not None and margin.lower > 0.0 else 1.0
    given = np.linspace(0.0, end, _SIZES + 1)[1:] if sizes is None else np.array(sizes, dtype=float)
    if not len(given) or not (given[0] > 0.0 and np.all(np.diff(given) > 0.0)):
        raise AnalysisError(f"save_growth: expected sizes that rise from above 0, got {sizes!r}.")
    asked: dict[str, Any] = {"gap": gap, "work": work, "leave_out": leave_out}
    found = []
    for size in given:
        box = _of_size(model, float(size))
        if what == "gain":
            found.append(worst_case_gain(box, inputs, outputs, **asked))
        else:
            found.append(worst_case(box, what, inputs, outputs, **asked))
    is_lower = found[0].kind in _IS_LOWER
    proved = np.array([each.lower if is_lower else each.upper for each in found])
    reached = np.array([each.upper if is_lower else each.lower for each in found])
    _draw(path, model, found[0].kind, given, proved, reached, margin)


def _of_size(model: System, size: float) -> System:
    """The system whose deltas are these over a size."""
    lft = model.lft
    scaled = LFT(size * lft.M11, size * lft.M12, lft.M21, lft.M22, lft.blocks)
    name = f"{model.name}, {size:.4g} times the box"
    return System(name, scaled, model.states, model.inputs, model.outputs, model.parameters)


def _draw(
    path: str | Path,
    model: System,
    kind: str,
    sizes: Array,
    proved: Array,
    reached: Array,
    margin: Bounds | None,
) -> None:
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    edges = np.append(0.0, sizes)
    shown = np.where(np.isfinite(proved), proved, np.nan)
    axes.stairs(shown, edges, baseline=None, color=COLORS[0], linewidth=1.4, label="proved")
    reached = np.where(np.isfinite(reached), reached, np.nan)
    axes.step(sizes, reached, ".-", where="post", color=COLORS[1], linewidth=1.0, label="reached")
    if margin is not None:
        for value, style, label in (
            (margin.lower, "--", f"margin, proved: {margin.lower:.4g}"),
            (margin.upper, ":", f"margin, worst case: {margin.upper:.4g}"),
        ):
            if np.isfinite(value):
                axes.axvline(value, color=WORST, linestyle=style, linewidth=1.0, label=label)
    axes.axvline(1.0, color="black", linewidth=0.6)
    known = np.concatenate([shown, reached])
    known = known[np.isfinite(known)]
    if len(known) and np.min(known) > 0.0 and np.max(known) > _DECADE * np.min(known):
        axes.set_yscale("log")
    axes.set_xlabel("size of the box (times the declared ranges)")
    axes.set_ylabel(kind)
    axes.set_title(f"{model.name}: {len(model.parameters)} parameters, order {model.order}")
    axes.grid(visible=True, linewidth=0.3, alpha=0.5)
    axes.legend(fontsize="small")
    write_figure(figure, path)
