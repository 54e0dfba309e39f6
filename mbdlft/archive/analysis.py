"""Analyses in an archive: /analyses/<name>, bounds of margins and gains with their proofs."""

from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.archive import archive as archives
from mbdlft.archive import layout
from mbdlft.archive.hdf5 import Part, Request, write_items
from mbdlft.archive.model import items_of_model
from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import ArchiveError
from mbdlft.robust.evidence import (
    Bounds,
    BoxProof,
    Interval,
    IntervalProof,
    LyapunovProof,
    MotionProof,
    Multipliers,
    PolynomialProof,
    Proof,
)
from mbdlft.system.model import System

_BY_NAME = ("worst", "sensitivity", "rates")
_PROOFS = {
    "boxes": BoxProof,
    "intervals": IntervalProof,
    "form": MotionProof,
    "polynomial": PolynomialProof,
    "lyapunov": LyapunovProof,
}


@arguments_checked
def save_analysis(path: str | Path, system: System, bounds: Bounds, name: str | None = None) -> None:
    """Write an analysis under /analyses/<name>, and its system under /models, if it is not there.

    Parameters
    ----------
    path : file, made if it does not exist
    system : System or LFTModel
        The one that was analyzed.
    bounds : Bounds
    name : str, optional
        Name of the system and kind of the analysis by default; an analysis of that name is replaced.
    """
    file = Path(path)
    what = f"{bounds.kind}, moving parameters" if bounds.rates else bounds.kind
    key = f"{system.name}: {what}" if name is None else name
    archives.check_name(file, "analysis", key)
    model_digest = layout.word(items_of_model(system), layout.DIGEST)
    if not file.exists() or system.name not in archives.model_names(file):
        archives.save(file, system)
    elif layout.word(items_of_model(archives.load(file, system.name)), layout.DIGEST) != model_digest:
        raise ArchiveError(
            f"{file}: the model {system.name!r} is another one than the one that was analyzed. Save the "
            "analysis in another file, or give the system another name."
        )
    with archives.naming(file, f"analysis {key!r}"):
        values = {"@model": system.name, "@model_digest": model_digest, **_values(bounds)}
        items = layout.with_digest(layout.encode(layout.ANALYSIS_TYPE, values))

    def fill(archive: Any) -> None:
        write_items(archive.require_group("analyses").create_group(key), items)

    archives.rewrite(file, fill, f"analyses/{key}")


@arguments_checked
def analysis_names(path: str | Path) -> tuple[str, ...]:
    """Names of the analyses in the archive at `path`, sorted."""
    return archives.names_in(Path(path), "analyses")


@arguments_checked
def load_analysis(
    path: str | Path, name: str | None = None, *, limit: int = archives.LIMIT
) -> tuple[System, Bounds]:
    """Read an analysis from an archive, with the system that was analyzed.

    Parameters
    ----------
    path : file
    name : str, optional
        May be left out if the archive has one analysis.
    limit : int
        Most bytes that its arrays may need.
    """
    file = Path(path)

    def make(part: Part, key: str) -> tuple[str, str, str, Bounds]:
        layout.check_digest(part.items)
        model, digest_of_model = (layout.word(part.items, path) for path in ("@model", "@model_digest"))
        try:
            return key, model, digest_of_model, _bounds(part.items)
        except KeyError as error:  # one of those that may all be missing
            raise ArchiveError(f"{error.args[0]} is missing.") from None

    request = Request("read", "analyses", "analysis", name, (layout.ANALYSIS_TYPE,), limit)
    key, model, digest_of_model, bounds = archives.read_one(file, request, make)
    system = archives.load(file, model)
    if layout.word(items_of_model(system), layout.DIGEST) != digest_of_model:
        raise ArchiveError(
            f"{file}: analysis {key!r}: the model {system.name!r} is not the one that was analyzed; "
            "it was replaced. Analyze it again."
        )
    return system, bounds


def _values(bounds: Bounds) -> dict[str, Any]:
    """Bounds and their proof as values by path."""
    values = {**layout.of_fields("", layout.ANALYSIS_TYPE, bounds), **_delta_values(bounds)}
    del values["@proved"]  # nothing that a file says of its proof is believed
    for name in _BY_NAME:
        by_name = getattr(bounds, name)
        values |= {f"{name}/name": list(by_name), f"{name}/value": list(by_name.values())}
    proof = bounds.proof
    if isinstance(proof, IntervalProof):
        values |= layout.columns("intervals", Interval._fields, proof.intervals)
        shapes = {getattr(m, name).shape for m in proof.multipliers for name in ("D", "G")}
        if len(shapes) > 1:
            raise ArchiveError(f"its multipliers have the shapes {sorted(shapes)}, and not one shape.")
        for name in ("D", "G"):
            stack = np.array([getattr(m, name) for m in proof.multipliers], dtype=complex)
            values |= _complex_values(f"intervals/{name}_", stack)
    for group, kind in _PROOFS.items():
        if isinstance(proof, kind):
            values |= layout.of_fields(group, layout.ANALYSIS_TYPE, proof)
    return values


def _complex_values(path: str, array: Any) -> dict[str, Any]:
    return {f"{path}real": array.real, f"{path}imaginary": array.imag}


def _complex(items: layout.Items, path: str) -> Any:
    return items[f"{path}real"] + 1j * items[f"{path}imaginary"]


def _delta_values(bounds: Bounds) -> dict[str, Any]:
    """Deltas by name: entries of all of them, row by row, one after the other."""
    deltas = [np.asarray(delta) for delta in bounds.delta.values()]
    entries = np.concatenate([*(delta.ravel() for delta in deltas), np.zeros(0)]).astype(complex)
    shapes = [delta.shape or (1, 1) for delta in deltas]
    return {
        "delta/name": list(bounds.delta),
        "delta/kind": [
            "full" if delta.ndim else "complex" if delta.dtype.kind == "c" else "real" for delta in deltas
        ],
        "delta/rows": [rows for rows, _ in shapes],
        "delta/columns": [columns for _, columns in shapes],
        **_complex_values("delta/", entries),
    }


def _bounds(items: layout.Items) -> Bounds:
    values: dict[str, Any] = {
        name: dict(layout.rows_of(items, name, ("name", "value")))
        for name in _BY_NAME
        if f"{name}/name" in items  # rates are not in the first files
    }
    for name in ("inputs", "outputs"):  # signals were in the proof at first
        paths = [path for path in (name, *(f"{group}/{name}" for group in _PROOFS)) if path in items]
        values |= {name: layout.words(items, paths[0])} if paths else {}
    return layout.record(Bounds, items, "", delta=_delta(items), proof=_proof(items), **values)


def _delta(items: layout.Items) -> dict[str, Any]:
    entries = _complex(items, "delta/")
    deltas: dict[str, Any] = {}
    start = 0
    for name, kind, rows, wide in layout.rows_of(items, "delta", ("name", "kind", "rows", "columns")):
        stop = start + rows * wide
        if rows < 0 or wide < 0 or stop > len(entries):
            raise ArchiveError("delta/rows and columns are not those of its entries.")
        block = entries[start:stop].reshape(rows, wide)
        if kind == "full":
            deltas[name] = block
        elif block.shape != (1, 1):
            raise ArchiveError(f"delta: {name} is {kind} and has {block.size} entries.")
        else:
            deltas[name] = complex(block[0, 0]) if kind == "complex" else float(block[0, 0].real)
        start = stop
    if start != len(entries):
        raise ArchiveError("delta/rows and columns are not those of its entries.")
    return deltas


def _proof(items: layout.Items) -> Proof | None:
    groups = [
        group for group in _PROOFS if any(path.startswith((f"{group}/", f"{group}@")) for path in items)
    ]
    if not groups:
        return None
    is_first = "intervals@beta" in items  # one part, and a bound of mu
    if len(groups) > 1 or ("intervals" in groups and is_first == ("intervals/log" in items)):
        raise ArchiveError("its proof is not whole.")
    if "intervals" not in groups:
        return layout.record(_PROOFS[groups[0]], items, groups[0])
    intervals = tuple(Interval(*row) for row in layout.rows_of(items, "intervals", Interval._fields))
    D, G = (_complex(items, f"intervals/{name}_") for name in ("D", "G"))
    beta = layout.plain(items, "intervals@beta") if is_first else 1.0
    multipliers = tuple(Multipliers(1.0, *pair) for pair in zip(D, G / beta**2, strict=True))
    if is_first:
        return IntervalProof((len(intervals), 0), intervals, multipliers)
    return layout.record(IntervalProof, items, "intervals", intervals=intervals, multipliers=multipliers)
