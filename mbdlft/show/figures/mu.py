"""The structured singular value over frequency: bounds that are proved on bands, as steps."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mbdlft.robust.evidence import Bounds
from mbdlft.robust.mu.singular_value import mu_bands
from mbdlft.show.figures.figures import COLORS, WORST, check_figure, over_frequency, write_figure
from mbdlft.system.model import System

_DECADES = 1.5  # beyond the poles


def save_mu(
    path: str | Path,
    model: System,
    margin: Bounds | None = None,
    *,
    gap: float = 0.1,
    leave_out: Sequence[str] = (),
) -> None:
    """Draw bounds of mu over frequency: steps that are proved, and lower bounds in each band.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : System or LFTModel
    margin : Bounds, optional
        Of `robust_stability`: 1/lower is drawn as what is proved for all frequencies, 1/upper as what is
        reached.
    gap, leave_out
        As for `mu_bands`.

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, or as `mu_bands`.
    """
    check_figure(path)
    sizes = np.abs(np.linalg.eigvals(model.A)) if len(model.A) else np.ones(1)
    sizes = sizes[sizes > 0.0] if np.any(sizes) else np.ones(1)
    ends = np.array([np.min(sizes), np.max(sizes)]) * 10.0 ** np.array([-_DECADES, _DECADES])
    low, high = (float(end) for end in ends)
    found = mu_bands(model, low, high, gap=gap, leave_out=leave_out)
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    top = np.where(np.isfinite(found.upper), found.upper, np.nan)
    label = f"D and G on {len(top)} bands: proved for all frequencies in them"
    axes.stairs(top, found.edges, baseline=None, color=COLORS[0], linewidth=1.4, label=label)
    seen = found.lower > 0.0
    if np.any(seen):
        axes.plot(
            found.at[seen], found.lower[seen], ".", color=COLORS[2], markersize=4.0,
            label="reached at one frequency",
        )  # fmt: skip
    if margin is not None and margin.lower > 0.0:
        label = f"proved for all: {1.0 / margin.lower:.4g}, margin {margin.lower:.4g}"
        axes.axhline(1.0 / margin.lower, color=WORST, linestyle="--", linewidth=1.0, label=label)
    if margin is not None and np.isfinite(margin.upper) and margin.upper > 0.0:
        label = f"worst case: {1.0 / margin.upper:.4g} at {margin.frequency:.4g} rad/s"
        at = min(max(margin.frequency, low), high)
        axes.plot([at], [1.0 / margin.upper], "o", color=WORST, markersize=5.0, label=label)
    over_frequency(axes, low, high)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("frequency (rad/s)")
    axes.set_ylabel("structured singular value")
    axes.set_title(f"{model.name}: {len(model.parameters)} parameters, order {model.order}")
    axes.grid(visible=True, which="both", linewidth=0.3, alpha=0.5)
    axes.legend(fontsize="small")
    write_figure(figure, path)
