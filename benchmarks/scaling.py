"""Seconds, memory and order against the number of bodies, and the slope of each stage.

    python -m benchmarks.scaling [--most N] [--seconds S] [--write PAGE] [--figure PICTURE]

Every model is verified before its row is printed: the certificate compares it with the nonlinear
equations, trimmed and linearized again. Seconds are those of the processor, which other
programs do not change; each case runs in a process of its own, so the memory is its own.
"""

import argparse
import json
import multiprocessing
import resource
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

import mbdlft
from benchmarks.arm import machine, write_between
from mbdlft.pipeline.models import build

SIZES = (5, 10, 15, 20, 25, 35, 50)
STAGES = ("assemble", "trim", "linearize", "extract", "reduce", "bound", "products", "check")
SHAPES = ("planar chain", "spatial chain", "star")
_ACCEPTED = 1e-6  # of an error of the certificate, relative to the size of an entry
_PAGE = 1.0  # MB: less is not measured
_SLOPE_FROM = 10  # bodies: below, fixed costs hide the slope


def scene(shape: str, count: int, *, few: bool) -> mbdlft.Scene:
    """Equal links with 5 or 3 n parameters: masses, lengths and angles."""
    chosen = {"m0", f"m{count - 1}", f"L{count // 2}", "t0", f"t{count // 2}"}
    parameters: list[mbdlft.Parameter] = []
    bodies, joints = [], []

    def quantity(name: str, nominal: float, unit: str) -> str:
        if few and name not in chosen:
            return f"{nominal!r}*deg" if unit == "deg" else f"{nominal!r}"
        if unit == "deg":
            parameters.append(mbdlft.Angle(name, nominal, 0.0, 80.0))
        else:
            parameters.append(mbdlft.Parameter(name, nominal, percent=20, unit=unit))
        return name

    for k in range(count):
        length = quantity(f"L{k}", 1.0, "m")
        bodies.append(
            mbdlft.RigidBody(
                name=f"link{k}",
                mass=quantity(f"m{k}", 2.0, "kg"),
                center_of_mass=(0, f"0.5*{length}", 0),
                inertia=mbdlft.Inertia(xx=0.1, yy=0.05, zz=0.1),
                ports={"tip": (0, length, 0)},
            )
        )
        before = "link0" if shape == "star" else f"link{k - 1}"
        joints.append(
            mbdlft.Revolute(
                name=f"joint{k}",
                parent=f"{before}.tip" if k else "ground",
                child=f"link{k}",
                axis=(0, 0, 1) if shape != "planar chain" and k % 2 else (1, 0, 0),
                position=quantity(f"t{k}", 20.0 + 10.0 * (k % 6), "deg"),
            )
        )
    return mbdlft.Scene(
        name="scaling", gravity=(0, 0, -9.81), parameters=parameters, bodies=bodies, joints=joints
    )


def measure(shape: str, count: int, few: bool) -> dict[str, Any]:  # noqa: FBT001
    """One row; runs in a process of its own."""
    start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    model_scene = scene(shape, count, few=few)
    marks: list[tuple[str, float]] = []
    built = build(model_scene, 0.0, lambda stage: marks.append((stage, time.process_time())))
    marks.append(("end", time.process_time()))
    spent = {a[0]: b[1] - a[1] for a, b in pairwise(marks)}
    certificate = built.model.certificate
    if not certificate.max_relative_error <= _ACCEPTED:
        raise SystemExit(f"{shape} of {count}: error {certificate.max_relative_error:.1e}")
    return {
        "shape": shape,
        "bodies": count,
        "parameters": len(model_scene.parameters),
        "few": few,
        "raw": sum(certificate.raw_order),
        "order": built.model.order,
        "bound": certificate.order_bound,
        "error": certificate.max_relative_error,
        "megabytes": max(_PAGE, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start) / 1024),
        "seconds": sum(spent.values()),
        "stages": {stage: spent.get(stage, 0.0) for stage in STAGES},
        "wall": sum(built.seconds.values()),
    }


def measured(sizes: Sequence[int], limit: float) -> list[dict[str, Any]]:
    """All rows; a family ends when its next member is expected to take longer than the limit."""
    rows: list[dict[str, Any]] = []
    context = multiprocessing.get_context("spawn")
    for shape in SHAPES:
        for few in (True, False):
            family: list[dict[str, Any]] = []
            for count in sizes:
                if expected(family, count) > limit:
                    break
                with context.Pool(1) as pool:
                    family.append(pool.apply(measure, (shape, count, few)))
                print(json.dumps(family[-1]), flush=True)
            rows += family
    return rows


def expected(family: Sequence[dict[str, Any]], count: int) -> float:
    """Seconds of the next member, by the power of the last two; 0 where there are not two."""
    if len(family) < 2:
        return 0.0
    before, last = family[-2:]
    power = np.log(last["seconds"] / before["seconds"]) / np.log(last["bodies"] / before["bodies"])
    return float(last["seconds"] * (count / last["bodies"]) ** power)


def slope(counts: Sequence[float], values: Sequence[float]) -> float:
    """Exponent of the power of n that fits best."""
    used = [(n, v) for n, v in zip(counts, values, strict=True) if n >= _SLOPE_FROM and v > 0.0]
    if len(used) < 2:
        return float("nan")
    n, v = np.log(np.array(used)).T
    return float(np.polyfit(n, v, 1)[0])


def families(rows: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Rows by shape and number of parameters."""
    found: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        found.setdefault(f"{row['shape']}, {'5' if row['few'] else '3n'} parameters", []).append(row)
    return found


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Rows, then slopes, in Markdown."""
    lines = [
        "| system | bodies | channels | order | bound | error | MB | seconds | slowest stage |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, family in families(rows).items():
        for r in family:
            slowest = max(r["stages"], key=r["stages"].get)
            lines.append(
                f"| {name} | {r['bodies']} | {r['raw']} | {r['order']} | {r['bound']} | {r['error']:.1e} "
                f"| {r['megabytes']:.0f} | {r['seconds']:.2f} | {slowest} {r['stages'][slowest]:.2f} |"
            )
    lines += ["", "| exponent of n | " + " | ".join(STAGES) + " | total | memory | order |"]
    lines.append("|---" * (len(STAGES) + 4) + "|")
    for name, family in families(rows).items():
        counts = [r["bodies"] for r in family]
        slopes = [slope(counts, [r["stages"][stage] for r in family]) for stage in STAGES]
        slopes += [slope(counts, [r[key] for r in family]) for key in ("seconds", "megabytes", "order")]
        cells = ["-" if np.isnan(value) else f"{value:.1f}" for value in slopes]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", machine()])


def figure(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Seconds, memory and order against the number of bodies, on logarithmic axes."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    fig, panels = plt.subplots(1, 3, figsize=(12, 4.8), layout="constrained")
    titles = {"seconds": "processor seconds", "megabytes": "memory (MB)", "order": "order"}
    for panel, (key, title) in zip(panels, titles.items(), strict=True):
        for k, (name, family) in enumerate(families(rows).items()):
            counts = [r["bodies"] for r in family]
            style = "o-" if family[0]["few"] else "s--"
            panel.loglog(counts, [r[key] for r in family], style, color=f"C{k // 2}", label=name)
        ticks = sorted({r["bodies"] for r in rows})
        panel.set_xticks(ticks, [str(n) for n in ticks])
        panel.minorticks_off()
        panel.set_xlabel("bodies")
        panel.set_title(title)
        panel.grid(visible=True, alpha=0.3)
    panels[0].axhline(20.0, color="0.5", lw=0.8)
    handles, labels = panels[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9)
    fig.savefig(path, dpi=120)
    plt.close(fig)


def main() -> None:
    """Print rows as JSON, then the tables; write them and the figure if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=int, default=SIZES[-1], help="largest number of bodies")
    parser.add_argument("--seconds", type=float, default=120.0, help="expected limit for one case")
    parser.add_argument("--write", type=Path)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    rows = measured([count for count in SIZES if count <= options.most], options.seconds)
    text = table(rows)
    print(text)
    if options.write:
        write_between(options.write, text)
    if options.figure:
        figure(options.figure, rows)


if __name__ == "__main__":
    main()
