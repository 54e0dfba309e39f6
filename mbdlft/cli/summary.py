"""The printed form of a model and of an archive: one JSON object, or tables and sentences."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from mbdlft.cli.output import console, print_json, table
from mbdlft.cli.responses import poles_summary, print_poles
from mbdlft.show.report.content import (
    checked_beside,
    conditioning,
    largest_error,
    order_sentences,
    well_posed,
)
from mbdlft.system.model import LFTModel, System

if TYPE_CHECKING:
    from mbdlft.system.theta import DeltaThetaModel
import math
from typing import Any


def report_model(
    model: LFTModel,
    seconds: Mapping[str, float],
    paths: Mapping[str, Path | None],
    notes: Sequence[str],
    *,
    as_json: bool,
) -> None:
    """Print a model that was made, with `notes`, the `seconds` of each stage and the written files."""
    seconds = {**seconds, "total": sum(seconds.values())}
    if as_json:
        print_json(_summary(model, seconds) | {"notes": list(notes)})
        return
    print_model(model)
    out = console()
    for note in notes:
        out.print(note)
    out.print("seconds: " + ", ".join(f"{name} {value:.3f}" for name, value in seconds.items()))
    for what, path in paths.items():
        if path is not None:
            out.print(f"{what}: {path}", soft_wrap=True)


def print_model(model: System) -> None:
    """Print the signals, parameters and poles of a model, and what its certificate says."""
    out = console()
    out.print(f"{model.name}  {model.description}", style="bold", highlight=False)
    for what in ("states", "inputs", "outputs"):
        signals = getattr(model, what)
        listed = ", ".join(f"{signal.name} ({signal.unit})" for signal in signals)
        out.print(f"{what} ({len(signals)}): {listed}".rstrip(": "), highlight=False)
    if isinstance(model, LFTModel):
        _print_evidence(model)
        print_poles(model)
        return
    blocks = ", ".join(f"{b.name} ({b.kind}, {b.outputs} x {b.inputs})" for b in model.lft.blocks)
    out.print(f"order {model.order}: {blocks or 'no blocks'}; stored without evidence")
    print_poles(model)


def _print_evidence(model: LFTModel) -> None:
    """Print what the certificate of a model says, and its trim."""
    out, certificate = console(), model.certificate
    out.print(_parameter_table(model))
    for line in order_sentences(model):
        out.print(line)
    out.print(largest_error(model))
    for line in checked_beside(model):
        out.print(line, highlight=False)
    for line in well_posed(model):
        out.print(line, highlight=False)
    if certificate.condition > 0.0:
        out.print(conditioning(certificate))
    if model.trim.signals:
        trimmed = ", ".join(
            f"{signal.name} = {value:.6g} {signal.unit}"
            for signal, value in zip(model.trim.signals, model.trim.nominal, strict=True)
        )
        out.print(f"trim at nominal: {trimmed}", highlight=False)


def _parameter_table(model: LFTModel) -> Table:
    """One row for each parameter: its range and its repetitions, with their sums below."""
    certificate = model.certificate
    rows = table(
        None, "parameter", "unit", "nominal >", "range >", "role", "repetitions >", "lower bound >",
        "before reduction >",
    )  # fmt: skip
    counts = (certificate.order, certificate.lower_bound, certificate.raw_order)
    rows.show_footer = True
    for column, footer in enumerate(("total", "", "", "", "", *map(sum, counts))):
        rows.columns[column].footer = str(footer)
    for p, *repetitions in zip(model.parameters, *counts, strict=True):
        span = f"[{p.low:g}, {p.high:g}]"
        rows.add_row(p.name, p.unit, f"{p.nominal:g}", span, p.role, *map(str, repetitions))
    return rows


def model_data(model: "System | DeltaThetaModel") -> dict[str, object]:
    """A stored model as plain data: that of its linear part if it has nonlinear functions."""
    if not isinstance(model, System):
        return {**model_data(model.linear), "functions": [str(part) for part in model.functions]}
    if isinstance(model, LFTModel):
        found = _summary(model, {})
        del found["seconds"]
        made = model.provenance
        return {**found, "created": made.created, "mbdlft": made.mbdlft, "casadi": made.casadi}
    signals = {
        what: [{"name": s.name, "unit": s.unit} for s in getattr(model, what)]
        for what in ("states", "inputs", "outputs")
    }
    return {"name": model.name, **signals, "order": model.order}


def _summary(model: LFTModel, seconds: Mapping[str, float]) -> dict[str, object]:
    """The model as plain data, for JSON."""
    certificate = model.certificate
    signals = {
        what: [{"name": s.name, "unit": s.unit} for s in getattr(model, what)]
        for what in ("states", "inputs", "outputs")
    }
    parameters = [
        {
            "name": p.name,
            "unit": p.unit,
            "nominal": p.nominal,
            "low": p.low,
            "high": p.high,
            "role": p.role,
            "order": certificate.order[k],
            "lower_bound": certificate.lower_bound[k],
            "gap": certificate.gap[k],
            "raw_order": certificate.raw_order[k],
            "doubtful": certificate.doubtful[k] if certificate.doubtful else None,
        }
        for k, p in enumerate(model.parameters)
    ]
    trim = [
        {"name": signal.name, "unit": signal.unit, "nominal": value}
        for signal, value in zip(model.trim.signals, model.trim.nominal, strict=True)
    ]
    return {
        "name": model.name,
        **signals,
        "parameters": parameters,
        "trim": trim,
        "order": sum(certificate.order),
        "lower_bound": sum(certificate.lower_bound),
        "raw_order": sum(certificate.raw_order),
        "order_bound": certificate.order_bound,
        "minimal": certificate.minimal,
        "exact_bound": certificate.exact_bound,
        "exact": certificate.exact,
        "truncation_error": certificate.truncation_error,
        "fit_error_bound": certificate.fit_error_bound,
        "max_relative_error": certificate.max_relative_error,
        "transfer_error": certificate.transfer_error if certificate.frequencies else None,
        "frequencies": list(certificate.frequencies),
        "near": list(certificate.near),
        "by_terms": [list(entry) for entry in certificate.by_terms],
        "condition": certificate.condition or None,
        "sign_changes": certificate.sign_changes if certificate.condition else None,
        "check_points": certificate.check_points,
        "well_posed": certificate.well_posed,
        "open_boxes": [[list(ends) for ends in box] for box in certificate.open_boxes],
        **poles_summary(model),
        "seconds": dict(seconds),
    }


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
