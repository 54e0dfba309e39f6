"""What an archive has, beside its models: sweeps and analyses; and all of it as plain data."""

import math
from pathlib import Path
from typing import Any

from mbdlft.cli.report import model_data


def beside_models(archive: Path) -> list[str]:
    """A line for the sweeps, and one for each stored analysis."""
    from mbdlft.archive.sweep import sweep_names

    sweeps = ", ".join(sweep_names(archive))
    lines = [f"sweeps: {sweeps}"] if sweeps else []
    for found in _analyses(archive):
        ends = " to ".join(
            "unbounded" if end is None else f"{end:.6g}" for end in (found["lower"], found["upper"])
        )
        lines.append(f"analysis {found['name']}: {found['kind']} {ends}")
    return lines


def archive_data(archive: Path, name: str | None) -> dict[str, Any]:
    """All models, or the one with a name, with their dates; sweeps and analyses by name."""
    from mbdlft.archive.archive import load, model_names
    from mbdlft.archive.sweep import sweep_names

    models = [model_data(load(archive, key)) for key in ([name] if name else model_names(archive))]
    if name:
        return {"models": models}
    return {
        "models": models,
        "sweeps": list(sweep_names(archive)),
        "analyses": _analyses(archive),
    }


def _analyses(archive: Path) -> list[dict[str, Any]]:
    """Name, kind and bounds of each stored analysis."""
    from mbdlft.archive.analysis import analysis_names, load_analysis

    found = []
    for name in analysis_names(archive):
        _, bounds = load_analysis(archive, name)
        ends = {"lower": _number(bounds.lower), "upper": _number(bounds.upper)}
        found.append({"name": name, "kind": bounds.kind, **ends})
    return found


def _number(value: float) -> float | None:
    """A number that JSON has; None for inf and NaN."""
    return value if math.isfinite(value) else None
