"""The figure: seconds per model against error, one panel for each system."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

from benchmarks.speed.methods import CANDIDATES

STYLES = {
    "mbdlft, LFT": ("*", "tab:red", 190),
    "mbdlft, equations": ("P", "tab:red", 90),
    "mbdlft, LFT compiled": ("*", "darkred", 110),
    "mbdlft, equations compiled": ("P", "darkred", 60),
    "pinocchio": ("o", "tab:blue", 60),
    "MuJoCo, one-sided": ("v", "tab:green", 60),
    "MuJoCo, central": ("^", "tab:green", 60),
    "Drake": ("s", "tab:purple", 55),
    "SymPy": ("D", "tab:orange", 50),
    "JAX": ("h", "tab:brown", 60),
    "JAX, GPU": ("H", "tab:brown", 60),
    "grid, quadratic": ("X", "0.45", 70),
    "grid, cubic": ("x", "0.45", 60),
    "plain C": ("d", "black", 60),
    "vectorized C": ("D", "black", 45),
}


def figure(path: Path, groups: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Filled: the largest error of an entry; a thin line leads to the largest error of a pole."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    columns = 2 if len(groups) > 1 else 1
    shape = (-(-len(groups) // columns), columns)
    fig, panels = plt.subplots(
        *shape, figsize=(11, 8.6), sharex=True, sharey=True, layout="constrained", squeeze=False
    )
    for panel, (name, rows) in zip(panels.ravel(), groups.items(), strict=False):
        for row in (row for row in rows if "error" in row):
            marker, color, size = STYLES[row["method"]]
            y = row["seconds_per_model"]
            panel.plot([row["error"], row["pole_error"]], [y, y], color=color, lw=0.8, alpha=0.6)
            panel.plot(row["pole_error"], y, "|", color=color, ms=9, alpha=0.8)
            panel.scatter(
                row["error"], y, marker=marker, color=color, s=size, zorder=3, label=row["method"]
            )
        missing = [r["method"] for r in rows if "error" not in r]
        # other tools once each, by their names; a way of this package as a whole
        absent = list(dict.fromkeys(n if "mbdlft" in n else n.split(",")[0] for n in missing))
        done = {row["method"] for row in rows if "error" in row}
        absent = [name for name in absent if name not in done]
        panel.set_title(f"{name}: {rows[0]['states']} states, {rows[0]['parameters']} parameters")
        if absent:
            panel.text(
                0.98,
                0.96,
                "not possible with\n" + "\n".join(absent),
                transform=panel.transAxes,
                ha="right",
                va="top",
                fontsize=9,
                color="0.4",
            )
        panel.set(xscale="log", yscale="log")
        panel.grid(visible=True, alpha=0.3)
    count = next(iter(groups.values()))[0]["samples"]
    for panel in panels[-1]:
        panel.set_xlabel(f"largest relative error over {count} samples (bar: of a pole)")
    for panel in panels[:, 0]:
        panel.set_ylabel("seconds per model")
    handles: dict[str, Any] = {}
    for panel in panels.ravel():
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    order = [c.name for c in CANDIDATES if c.name in handles]
    fig.legend(
        [handles[label] for label in order], order, loc="outside lower center", ncols=5, fontsize=9
    )
    fig.savefig(path, dpi=120)
    plt.close(fig)
