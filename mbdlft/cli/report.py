"""The printed form of a model: one JSON object, or tables and sentences on what is proved."""

import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich.table import Table

from mbdlft.cli.poles import poles_summary, print_poles
from mbdlft.cli.tables import console, table
from mbdlft.system.model import Certificate, LFTModel
from mbdlft.system.system import System

_EPS = sys.float_info.epsilon
_MOST_BOXES = 4  # that are listed
_MATRIX = 'format = "mbdlft-matrix/'  # how the text of a matrix begins, in provenance


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
        sys.stdout.write(json.dumps(_summary(model, seconds), indent=2) + "\n")
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
    for line in _order_sentences(model):
        out.print(line)
    truth = "the nonlinear equations, linearized with numbers"
    if model.trim.signals:
        truth = "re-trimming and re-linearizing"
    elif _MATRIX in model.provenance.scene[: len(_MATRIX) + 40]:
        truth = "the matrix itself"
    out.print(
        f"maximum relative error {certificate.max_relative_error:.1e} against {truth} at "
        f"{certificate.check_points} points and corners"
        + (", before truncation" if certificate.truncation_error > 0.0 else "")
        + (", at the fitted positions" if certificate.fit_error_bound > 0.0 else "")
    )
    for line in _checked_beside(model):
        out.print(line, highlight=False)
    for line in _well_posed(model):
        out.print(line, highlight=False)
    if certificate.condition > 0.0:
        out.print(_conditioning(certificate))
    if model.trim.signals:
        trimmed = ", ".join(
            f"{signal.name} = {value:.6g} {signal.unit}"
            for signal, value in zip(model.trim.signals, model.trim.nominal, strict=True)
        )
        out.print(f"trim at nominal: {trimmed}", highlight=False)


def _checked_beside(model: LFTModel) -> Iterator[str]:
    """Sentences on transfer functions, on entries without a size of their own, and on near relations."""
    certificate = model.certificate
    if certificate.frequencies:
        low, high = min(certificate.frequencies), max(certificate.frequencies)
        yield (
            f"largest error of transfer functions {certificate.transfer_error:.1e} of their row, at "
            f"{len(certificate.frequencies)} frequencies, {low:.3g} to {high:.3g} rad/s"
        )
    yield from (f"nearly: {text}" for text in certificate.near)
    if certificate.by_terms:
        rows = [f"d{s.name}/dt" for s in model.states] + [s.name for s in model.outputs]
        columns = [signal.name for signal in (*model.states, *model.inputs)]
        named = [f"{rows[i]} by {columns[j]}" for i, j in certificate.by_terms]
        more = f" and {len(named) - _MOST_BOXES} more" if len(named) > _MOST_BOXES else ""
        yield (
            f"nothing but rounding of terms that cancel, and compared with these: "
            f"{', '.join(named[:_MOST_BOXES])}{more}"
        )


def _well_posed(model: LFTModel) -> Iterator[str]:
    """Sentences on whether the model is regular at every value in the ranges."""
    certificate = model.certificate
    if certificate.well_posed == "proved":
        yield "well-posed: proved in the whole range"
        return
    points = certificate.check_points
    yield f"well-posed: not proved; it is at {points} points and corners and on lines to some of them"
    boxes = certificate.open_boxes
    for box in boxes[:_MOST_BOXES]:
        parts = [
            f"{p.name} in [{low:.6g}, {high:.6g}] {p.unit}".removesuffix(" 1")
            for p, (low, high) in zip(model.parameters, box, strict=True)
            if (low, high) != (p.low, p.high)
        ]
        yield f"  open: {', '.join(parts) or 'the whole range'}"
    if len(boxes) > _MOST_BOXES:
        yield f"  and {len(boxes) - _MOST_BOXES} more; --prove with more work may close them"


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


def _order_sentences(model: LFTModel) -> Iterator[str]:
    """Sentences on the order, its lower bound, and how the model differs from an exact one."""
    certificate = model.certificate
    alone = sum(certificate.lower_bound)
    if certificate.exact:
        proof = "minimal: proved" if certificate.minimal else "not proved minimal"
        together = certificate.order_bound - alone
        if certificate.exact_bound:
            proof += f" ({f'the {alone}' if together else 'bound'} in exact arithmetic)"
        parts = f" ({alone} one by one, {together} more together)" if together else ""
        yield f"order {model.order}, lower bound {certificate.order_bound}{parts}: {proof}"
    else:
        yield f"order {model.order}; the lower bound {alone} is that of exact models"
        if certificate.truncation_error == math.inf:
            yield "not exact: a part of it is truncated, and no bound of the error holds for the whole"
        elif certificate.truncation_error > 0.0:
            yield (
                f"not exact: values differ by at most {_upward(certificate.truncation_error)} of their "
                "typical sizes, on the whole range"
            )
        if certificate.fit_error_bound > 0.0:
            yield (
                f"not exact: positions are fits, within {_upward(certificate.fit_error_bound)} rad or m "
                "of the equilibrium, on the whole range"
            )
    if any(certificate.doubtful):
        unclear = ", ".join(
            f"{p.name} {count}"
            for p, count in zip(model.parameters, certificate.doubtful, strict=True)
            if count
        )
        yield f"ranks that rounding makes unclear, not counted in the bound: {unclear}"


def _conditioning(certificate: Certificate) -> str:
    """A sentence on how much the rounding of the data may change the entries of the model."""
    change = certificate.condition * _EPS
    text = f"condition {certificate.condition:.1e}: rounding of the data alone may change an entry "
    text += f"by {change:.1e} of itself"
    if change > _EPS**0.5:
        text = f"ill-conditioned, {text}"
    if certificate.sign_changes:
        text += (
            f"; {certificate.sign_changes} entries change their sign in the range, and near there have "
            "digits relative to their largest size only"
        )
    return text


def _upward(error: float) -> str:
    """A bound as a text of three digits, which is never rounded down."""
    text = f"{error:.2e}"
    return text if float(text) >= error else f"{error + 0.01 * 10.0 ** int(text[-3:]):.2e}"


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
