"""Analyses in an archive: /analyses/<name>, bounds of margins and gains with their proofs."""

from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.archive.archive import (
    LIMIT,
    check_name,
    load,
    model_names,
    names_in,
    naming,
    read_one,
    rewrite,
    save,
)
from mbdlft.archive.hdf5 import Part, write_items
from mbdlft.archive.layout import (
    ANALYSIS_TYPE,
    DIGEST,
    VERSION,
    Items,
    check_digest,
    digest,
    floats,
    integers,
    text,
    texts,
    word,
    words,
)
from mbdlft.archive.model import items_of_model
from mbdlft.archive.reading import Request
from mbdlft.base.errors import ArchiveError
from mbdlft.robust.evidence import (
    Bounds,
    BoxProof,
    Interval,
    IntervalProof,
    MotionProof,
    Multipliers,
    Proof,
)
from mbdlft.system.model import System

_NUMBERS = ("lower", "upper", "frequency", "work")
_PAIRS = ("worst", "sensitivity", "rates")
_MATRICES = ("D", "G")
_FORM_NUMBERS = ("k", "gain", "time")
_FORM_ARRAYS = ("P", "X", "Y", "states", "channels")
_SIGNALS = ("inputs", "outputs")
_INSIDE = 1.0 - 1e-15  # a margin is not above 1/beta, however it was rounded


def save_analysis(
    path: str | Path, system: System, bounds: Bounds, name: str | None = None
) -> None:
    """Write an analysis under /analyses/<name>, and its system under /models, if it is not there.

    Parameters
    ----------
    path : file, made if it does not exist
    system : System or LFTModel
        The one that was analyzed.
    bounds : Bounds
    name : str, optional
        Name of the system and kind of the analysis by default; an analysis of that name is replaced.

    Raises
    ------
    ArchiveError
        The archive has another model of the name of the system; or `save` would raise an error.
    """
    file = Path(path)
    what = f"{bounds.kind}, moving parameters" if bounds.rates else bounds.kind
    key = f"{system.name}: {what}" if name is None else name
    check_name(file, "analysis", key)
    model_digest = word(items_of_model(system), DIGEST)
    if not file.exists() or system.name not in model_names(file):
        save(file, system)
    elif word(items_of_model(load(file, system.name)), DIGEST) != model_digest:
        raise ArchiveError(
            f"{file}: the model {system.name!r} is another one than the one that was analyzed. Save the "
            "analysis in another file, or give the system another name."
        )
    with naming(file, f"analysis {key!r}"):
        items = _items_of(bounds, system.name, model_digest)

    def fill(archive: Any) -> None:
        write_items(archive.require_group("analyses").create_group(key), items)

    rewrite(file, fill, f"analyses/{key}")


def analysis_names(path: str | Path) -> tuple[str, ...]:
    """Names of the analyses in an archive, sorted.

    Parameters
    ----------
    path : file

    Raises
    ------
    ArchiveError
        The file is missing, truncated, foreign or newer.
    """
    return names_in(Path(path), "analyses")


def load_analysis(
    path: str | Path, name: str | None = None, *, limit: int = LIMIT
) -> tuple[System, Bounds]:
    """Read an analysis from an archive, with the system that was analyzed.

    Parameters
    ----------
    path : file
    name : str, optional
        May be left out if the archive has one analysis.
    limit : int
        Most bytes that its arrays may need.

    Returns
    -------
    System or LFTModel, Bounds

    Raises
    ------
    ArchiveError
        The file is missing, truncated, changed, foreign or newer, or the analysis is missing or
        incomplete, or its model has been replaced.
    """
    file = Path(path)

    def make(part: Part, key: str) -> tuple[str, str, str, Bounds]:
        check_digest(part.items)
        model, digest_of_model = (word(part.items, path) for path in ("@model", "@model_digest"))
        return key, model, digest_of_model, _bounds_of(part.items)

    request = Request("read", "analyses", "analysis", name, (ANALYSIS_TYPE,), limit)
    key, model, digest_of_model, bounds = read_one(file, request, make)
    system = load(file, model)
    if word(items_of_model(system), DIGEST) != digest_of_model:
        raise ArchiveError(
            f"{file}: analysis {key!r}: the model {system.name!r} is not the one that was analyzed; "
            "it was replaced. Analyze it again."
        )
    return system, bounds


def _items_of(bounds: Bounds, model: str, model_digest: str) -> Items:
    items: Items = {
        "@encoding_type": text(ANALYSIS_TYPE),
        "@encoding_version": text(VERSION),
        "@model": text(model),
        "@model_digest": text(model_digest),
        "@kind": text(bounds.kind),
        "@reason": text(bounds.reason),
        "@proved": np.array(bounds.proved),
        "leave_out": texts(list(bounds.leave_out)),
        "fixed": texts(list(bounds.fixed)),
    }
    for name in _NUMBERS:
        items[f"@{name}"] = np.array(getattr(bounds, name), dtype="<f8")
    if bounds.motion is not None:
        items["motion"] = np.ascontiguousarray(bounds.motion, dtype="<f8")
    for name in _PAIRS:
        pairs = getattr(bounds, name)
        items[f"{name}/name"] = texts(list(pairs))
        items[f"{name}/value"] = np.array(list(pairs.values()), dtype="<f8")
    items |= _items_of_delta(bounds)
    if isinstance(bounds.proof, BoxProof):
        for name in ("k", "gain", "shift", "slope"):
            items[f"boxes@{name}"] = np.array(getattr(bounds.proof, name), dtype="<f8")
        items["boxes/log"] = np.array(bounds.proof.log, dtype="<i8")
        for name in _SIGNALS:
            items[f"boxes/{name}"] = texts(list(getattr(bounds.proof, name)))
    elif isinstance(bounds.proof, MotionProof):
        items |= _items_of_form(bounds.proof)
    elif bounds.proof is not None:
        items |= _items_of_intervals(bounds.proof)
    items[DIGEST] = text(digest(items))
    return items


def _items_of_delta(bounds: Bounds) -> Items:
    """Deltas by name: entries of all of them, row by row, one after the other."""
    values = [np.asarray(value) for value in bounds.delta.values()]
    entries = np.concatenate([*(value.ravel() for value in values), np.zeros(0)]).astype(complex)
    kinds = [
        "full" if value.ndim else "complex" if value.dtype.kind == "c" else "real"
        for value in values
    ]
    shapes = np.array([value.shape or (1, 1) for value in values], dtype="<i8").reshape(-1, 2)
    return {
        "delta/name": texts(list(bounds.delta)),
        "delta/kind": texts(kinds),
        "delta/rows": np.ascontiguousarray(shapes[:, 0]),
        "delta/columns": np.ascontiguousarray(shapes[:, 1]),
        "delta/real": np.ascontiguousarray(entries.real, dtype="<f8"),
        "delta/imaginary": np.ascontiguousarray(entries.imag, dtype="<f8"),
    }


def _items_of_intervals(proof: IntervalProof) -> Items:
    items: Items = {
        "intervals@k": np.array(proof.k, dtype="<f8"),
        "intervals/log": np.array(proof.log, dtype="<i8"),
    }
    for name in ("fixed", *_SIGNALS):
        items[f"intervals/{name}"] = texts(list(getattr(proof, name)))
    for name in Interval._fields:
        items[f"intervals/{name}"] = np.array([getattr(i, name) for i in proof.intervals], "<f8")
    for name in _MATRICES:
        stack = np.array([getattr(found, name) for found in proof.multipliers], dtype=complex)
        items[f"intervals/{name}_real"] = np.ascontiguousarray(stack.real)
        items[f"intervals/{name}_imaginary"] = np.ascontiguousarray(stack.imag)
    return items


def _items_of_form(proof: MotionProof) -> Items:
    items: Items = {f"form@{name}": np.array(getattr(proof, name), "<f8") for name in _FORM_NUMBERS}
    for name in _FORM_ARRAYS:
        items[f"form/{name}"] = np.ascontiguousarray(getattr(proof, name), dtype="<f8")
    return items | {f"form/{name}": texts(list(getattr(proof, name))) for name in _SIGNALS}


def _bounds_of(items: Items) -> Bounds:
    pairs = {
        name: dict(
            zip(words(items, f"{name}/name"), floats(items, f"{name}/value").tolist(), strict=True)
        )
        for name in _PAIRS
        if f"{name}/name" in items  # rates are not in the first files
    }
    lower, upper, frequency, work = (float(items[f"@{name}"]) for name in _NUMBERS)
    return Bounds(
        kind=word(items, "@kind"),
        lower=lower,
        upper=upper,
        worst=pairs["worst"],
        delta=_delta_of(items),
        frequency=frequency,
        proved=bool(items["@proved"]),
        sensitivity=pairs["sensitivity"],
        work=work,
        reason=word(items, "@reason"),
        proof=_proof_of(items),
        leave_out=tuple(words(items, "leave_out")),
        rates=pairs.get("rates", {}),
        motion=floats(items, "motion") if "motion" in items else None,
        fixed=tuple(words(items, "fixed")) if "fixed" in items else (),
    )


def _delta_of(items: Items) -> dict[str, Any]:
    entries = floats(items, "delta/real") + 1j * floats(items, "delta/imaginary")
    found: dict[str, Any] = {}
    start = 0
    for name, kind, rows, columns in zip(
        words(items, "delta/name"),
        words(items, "delta/kind"),
        integers(items, "delta/rows"),
        integers(items, "delta/columns"),
        strict=True,
    ):
        stop = start + rows * columns
        if rows < 0 or columns < 0 or stop > len(entries):
            raise ArchiveError("delta/rows and columns are not those of its entries.")
        part = entries[start:stop].reshape(rows, columns)
        if kind == "full":
            found[name] = part
        elif part.shape != (1, 1):
            raise ArchiveError(f"delta: {name} is {kind} and has {part.size} entries.")
        else:
            found[name] = complex(part[0, 0]) if kind == "complex" else float(part[0, 0].real)
        start = stop
    if start != len(entries):
        raise ArchiveError("delta/rows and columns are not those of its entries.")
    return found


def _proof_of(items: Items) -> Proof | None:
    kinds = {
        "boxes": (5, 7),
        "intervals": (8, 12),
        "form": (10,),
    }  # first ones have no region, no parts
    found = {
        kind: sum(path.startswith((f"{kind}/", f"{kind}@")) for path in items) for kind in kinds
    }
    there = [kind for kind, count in found.items() if count]
    if not there:
        return None
    (kind, *others) = there
    if others or found[kind] not in kinds[kind]:
        raise ArchiveError("its proof is not whole.")
    if kind == "form":
        k, gain, time = (float(items[f"form@{name}"]) for name in _FORM_NUMBERS)
        P, X, Y, states, channels = (floats(items, f"form/{name}") for name in _FORM_ARRAYS)
        inputs, outputs = (tuple(words(items, f"form/{name}")) for name in _SIGNALS)
        return MotionProof(k, P, X, Y, states, channels, time, gain, inputs, outputs)
    if kind == "boxes":
        return BoxProof(
            float(items["boxes@k"]),
            integers(items, "boxes/log"),
            float(items["boxes@gain"]),
            tuple(words(items, "boxes/inputs")),
            tuple(words(items, "boxes/outputs")),
            *(float(items.get(f"boxes@{name}", 0.0)) for name in ("shift", "slope")),
        )
    return _intervals_of(items)


def _intervals_of(items: Items) -> IntervalProof:
    ends = [floats(items, f"intervals/{name}").tolist() for name in Interval._fields]
    D, G = (
        floats(items, f"intervals/{name}_real") + 1j * floats(items, f"intervals/{name}_imaginary")
        for name in _MATRICES
    )
    intervals = tuple(Interval(*row) for row in zip(*ends, strict=True))
    if "intervals@beta" in items:  # the first files: one part, and a bound of mu
        beta = float(items["intervals@beta"])
        multipliers = tuple(Multipliers(1.0, *pair) for pair in zip(D, G / beta**2, strict=True))
        return IntervalProof(_INSIDE / beta, (len(intervals), 0), intervals, multipliers)
    multipliers = tuple(Multipliers(1.0, *pair) for pair in zip(D, G, strict=True))
    names = (tuple(words(items, f"intervals/{name}")) for name in ("fixed", *_SIGNALS))
    k, log = float(items["intervals@k"]), integers(items, "intervals/log")
    return IntervalProof(k, log, intervals, multipliers, *names)
