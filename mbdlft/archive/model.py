"""One model or system as the items of an HDF5 group, and its certificate: docs/archive-format.md."""

import itertools
import math
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from mbdlft.archive.hdf5 import FAILURES
from mbdlft.archive.layout import (
    DIGEST,
    MODEL_TYPE,
    SYSTEM_TYPE,
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
from mbdlft.archive.layout import text as text_item
from mbdlft.archive.program import (
    items_of_program,
    items_of_theta,
    program_of_items,
    theta_of_items,
)
from mbdlft.base.errors import ArchiveError, MbdlftError
from mbdlft.base.parameter import BilinearMap, Parameter
from mbdlft.base.unit import Signal
from mbdlft.lft.block import ComplexBlock, FullBlock
from mbdlft.lft.lft import LFT, Block
from mbdlft.system.model import Certificate, LFTModel, Parameters, Provenance, System, Trim
from mbdlft.system.theta import DeltaThetaModel

KINDS = (MODEL_TYPE, SYSTEM_TYPE)
_MATRICES = ("A", "B_w", "B_u", "C_z", "D_zw", "D_zu", "C_y", "D_yw", "D_yu")
_FOUR = ("D_zw", "D_zu", "D_yw", "D_yu")
_ULPS = 8.0  # between machines a tangent may differ in its last bit
_MADE = ("mbdlft", "casadi", "numpy", "h5py", "created")
_POINTER = "in the dataset provenance/scene"  # where readers of 1.0 look for the text


def items_of_model(model: System | DeltaThetaModel) -> Items:
    """The items of a model or a system, and of its nonlinear functions, with their digest.

    Raises
    ------
    ArchiveError
        A text cannot be stored, or an entry is complex.
    """
    functions: Items = {}
    if isinstance(model, DeltaThetaModel):
        functions, model = items_of_theta(model), model.linear
    certified = isinstance(model, LFTModel)
    items: Items = {
        "@encoding_type": text(MODEL_TYPE if certified else SYSTEM_TYPE),
        "@encoding_version": text(VERSION),
        "@time_domain": text("continuous"),
    }
    if model.description:
        items["@description"] = text(model.description)
    for name in _MATRICES:
        items[name] = _numbers(name, getattr(model, name))
    for name in ("states", "inputs", "outputs"):
        items |= items_of_signals(name, getattr(model, name))
    items |= _items_of_blocks("delta", model.lft, model.parameters)
    items |= _items_of_parameters(model.parameters)
    if isinstance(model, LFTModel):
        items |= _items_of_evidence(model)
        if model.known_program is not None:
            items |= items_of_program(model.known_program)
    items |= functions
    items[DIGEST] = text(digest(items))
    return items


def _items_of_evidence(model: LFTModel) -> Items:
    items = items_of_signals("trim", model.trim.signals)
    items["trim/nominal"] = _numbers("trim/nominal", model.trim.nominal)
    lft = model.trim.lft
    if lft is not None:
        for name, matrix in zip(_FOUR, (lft.M11, lft.M12, lft.M21, lft.M22), strict=True):
            items[f"trim/lft/{name}"] = _numbers(f"trim/lft/{name}", matrix)
        items |= _items_of_blocks("trim/lft/delta", lft, model.parameters)
    for name, values in items_of_certificate(model.certificate).items():
        items[f"certificate{name}" if name[0] == "@" else f"certificate/{name}"] = values
    for name in _MADE:
        items[f"provenance@{name}"] = text(getattr(model.provenance, name))
    items["provenance@scene"] = text(_POINTER)
    items["provenance/scene"] = characters(model.provenance.scene)
    return items


def characters(long: str) -> Any:
    """A long text as the bytes (n,) of its UTF-8."""
    encoded = text(long)
    return np.frombuffer(encoded.tobytes() if long else b"", dtype=np.uint8)


def _items_of_parameters(parameters: Sequence[Parameter]) -> Items:
    items: Items = {}
    for name in ("name", "unit", "role", "substitution"):
        items[f"parameters/{name}"] = texts([getattr(p, name) for p in parameters])
    for name in ("nominal", "low", "high", "reference"):
        items[f"parameters/{name}"] = _numbers(name, [getattr(p, name) for p in parameters])
    maps = np.array([_row(p.map) for p in parameters], dtype="<f8").reshape(-1, 3)
    items["parameters/map"] = maps
    return items


def _row(m: BilinearMap) -> tuple[float, float, float]:
    return (m.b0, m.b1, m.a1)


def items_of_signals(group: str, signals: Sequence[Signal]) -> Items:
    """Names and units of the signals of a group such as ``states``."""
    return {
        f"{group}/name": texts([signal.name for signal in signals]),
        f"{group}/unit": texts([signal.unit for signal in signals]),
    }


def _items_of_blocks(group: str, lft: LFT, parameters: Sequence[Parameter]) -> Items:
    """The blocks of Delta, and of each of its rows the parameter; -1 where there is none."""
    place = {p.name: k for k, p in enumerate(parameters)}
    rows = [place[b.name] if b.kind == "real" else -1 for b in lft.blocks for _ in range(b.outputs)]
    return {
        f"{group}/parameter": np.array(rows, dtype="<i8"),
        f"{group}/name": texts([block.name for block in lft.blocks]),
        f"{group}/kind": texts([block.kind for block in lft.blocks]),
        f"{group}/rows": np.array([block.outputs for block in lft.blocks], dtype="<i8"),
        f"{group}/columns": np.array([block.inputs for block in lft.blocks], dtype="<i8"),
    }


def _numbers(name: str, values: Any) -> Any:
    found = np.asarray(values)
    if found.dtype.kind == "c":
        raise ArchiveError(f"{name} has an entry that is complex, and archives hold real entries.")
    return np.ascontiguousarray(found, dtype="<f8")


def model_of_items(items: Items, name: str) -> System | DeltaThetaModel:
    """The model or system of the items of a group, which agree with the layout.

    Raises
    ------
    ArchiveError
        The content is not what was written, or values do not agree.
    """
    if word(items, "@encoding_version") != "1.0":
        check_digest(items)
    if word(items, "@time_domain") != "continuous":
        found = word(items, "@time_domain")
        raise ArchiveError(f"time_domain is {found!r}, expected 'continuous'.")
    try:
        model = _system(items, name)
        if isinstance(model, LFTModel) and "theta/name" in items:
            return theta_of_items(items, model)
        return model
    except ArchiveError:
        raise
    except (MbdlftError, *FAILURES) as error:
        raise ArchiveError(f"is not as specified: {error}") from None


def _system(items: Items, name: str) -> System:
    parameters = _parameters(items)
    signals = {key: signals_of(items, key) for key in ("states", "inputs", "outputs")}
    blocks = _blocks(items, "delta", parameters)
    M = {key: floats(items, key) for key in _MATRICES}
    lft = LFT(
        M["D_zw"],
        np.hstack([M["C_z"], M["D_zu"]]),
        np.vstack([M["B_w"], M["D_yw"]]),
        np.block([[M["A"], M["B_u"]], [M["C_y"], M["D_yu"]]]),
        blocks,
    )
    common: dict[str, Any] = {
        "name": name,
        "lft": lft,
        **signals,
        "parameters": Parameters(parameters),
        "description": word(items, "@description"),
    }
    if word(items, "@encoding_type") == SYSTEM_TYPE:
        return System(**common)
    sizes = tuple(block.size for block in blocks if block.kind == "real")
    trim = _trim(items, parameters)
    return LFTModel(
        **common,
        trim=trim,
        program=program_of_items(items, len(parameters), lft, trim.lft),
        certificate=certificate_of(items, sizes),
        provenance=Provenance(
            scene=long_text(items, "provenance/scene", "provenance@scene"),
            **{key: word(items, f"provenance@{key}") for key in _MADE},
        ),
    )


def long_text(items: Items, path: str, first: str) -> str:
    """A text that is stored as bytes at a path, or, in the first files, as the attribute `first`."""
    if path not in items:
        return word(items, first)
    try:
        return items[path].tobytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise ArchiveError(f"{path} is not UTF-8 text: {error}.") from None


def _parameters(items: Items) -> tuple[Parameter, ...]:
    names = words(items, "parameters/name")
    _check_unique("parameters", names)
    labels = {key: words(items, f"parameters/{key}") for key in ("unit", "role", "substitution")}
    numbers = {
        key: floats(items, f"parameters/{key}") for key in ("nominal", "low", "high", "reference")
    }
    parameters = tuple(
        Parameter(
            names[k],
            float(numbers["nominal"][k]),
            float(numbers["low"][k]),
            float(numbers["high"][k]),
            unit=labels["unit"][k],
            role=cast(Any, labels["role"][k]),
            substitution=cast(Any, labels["substitution"][k]),
            reference=float(numbers["reference"][k]),
        )
        for k in range(len(names))
    )
    for parameter, row in zip(parameters, floats(items, "parameters/map"), strict=True):
        expected = np.array(_row(parameter.map))
        if not np.all(
            np.abs(row - expected) <= _ULPS * np.finfo(float).eps * np.max(np.abs(expected))
        ):
            raise ArchiveError(
                f"parameters/map of {parameter.name!r} is {row.tolist()}, but its range gives "
                f"{expected.tolist()}."
            )
    return parameters


def _trim(items: Items, parameters: Sequence[Parameter]) -> Trim:
    signals = signals_of(items, "trim")
    nominal = tuple(float(value) for value in floats(items, "trim/nominal"))
    if "trim/lft/D_zw" not in items:
        return Trim(signals, nominal, None)
    M11, M12, M21, M22 = (floats(items, f"trim/lft/{key}") for key in _FOUR)
    lft = LFT(M11, M12, M21, M22, _blocks(items, "trim/lft/delta", parameters))
    return Trim(signals, nominal, lft)


def _blocks(items: Items, group: str, parameters: Sequence[Parameter]) -> tuple[Block, ...]:
    """The blocks of Delta; the rows of their parameters, which 1.0 has alone, agree with them."""
    rows = items[f"{group}/parameter"]
    if f"{group}/kind" not in items:
        if np.any(np.diff(rows) < 0) or np.any((rows < 0) | (rows >= len(parameters))):
            raise ArchiveError(
                f"{group}/parameter is not sorted, or names a parameter that is not there."
            )
        counts = np.bincount(rows, minlength=len(parameters))
        return tuple(Block(p.name, int(count)) for p, count in zip(parameters, counts, strict=True))
    blocks = tuple(
        map(
            _block,
            words(items, f"{group}/name"),
            words(items, f"{group}/kind"),
            integers(items, f"{group}/rows"),
            integers(items, f"{group}/columns"),
        )
    )
    place = {p.name: k for k, p in enumerate(parameters)}
    if sum(max(0, block.outputs) for block in blocks) != len(rows) or any(
        block.outputs < 0 for block in blocks
    ):
        raise ArchiveError(f"{group}/rows: expected {len(rows)} together, as many as channels.")
    expected = [
        place.get(b.name, -2) if b.kind == "real" else -1 for b in blocks for _ in range(b.outputs)
    ]
    if rows.tolist() != expected:
        raise ArchiveError(
            f"{group}/parameter is not sorted, or names a parameter that is not there: it does not "
            f"agree with {group}/name and {group}/rows."
        )
    return blocks


def _block(name: str, kind: str, rows: int, columns: int) -> Block:
    if kind == "full":
        return FullBlock(name, columns, rows)
    if kind not in ("real", "complex") or rows != columns:
        raise ArchiveError(
            f"delta: block {name!r} is {kind!r}, {rows} x {columns}; expected 'real' or 'complex' and "
            "square, or 'full'."
        )
    return Block(name, rows) if kind == "real" else ComplexBlock(name, rows)


def signals_of(items: Items, group: str) -> tuple[Signal, ...]:
    """The signals of a group such as ``states``; each name occurs once."""
    names = words(items, f"{group}/name")
    _check_unique(group, names)
    return tuple(map(Signal, names, words(items, f"{group}/unit")))


def _check_unique(group: str, names: Sequence[str]) -> None:
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ArchiveError(f"{group}/name: {twice!r} stands twice.")


PROVED, CHECKED, OPEN = "proved", "checked", "open"
_PLACES = ("order", "lower_bound", "raw_order")
_ERRORS = (
    "max_relative_error",
    "truncation_error",
    "fit_error_bound",
    "condition",
    "transfer_error",
)
_COUNTS = ("check_points", "seed", "sign_changes")


def rests_on(certificate: Certificate) -> dict[str, str]:
    """What each number of a certificate rests on.

    Returns
    -------
    dict of names to "proved" (a theorem, in exact or outward-rounded arithmetic), "checked" (computed in
    floating point, or compared at points) or "open" (nothing is known)
    """
    c = certificate
    found = {
        "lower_bound": PROVED if c.exact_bound else CHECKED,
        "max_relative_error": CHECKED,
        "well_posed": PROVED if c.well_posed == PROVED else OPEN if c.open_boxes else CHECKED,
    }
    if c.truncation_error > 0.0:
        found["truncation_error"] = OPEN if math.isinf(c.truncation_error) else PROVED
    if c.fit_error_bound > 0.0:
        found["fit_error_bound"] = PROVED
    if c.condition > 0.0:
        found["condition"] = CHECKED
    if c.frequencies:
        found["transfer_error"] = CHECKED
    return dict(sorted(found.items()))


def items_of_certificate(certificate: Certificate) -> Items:
    """The items of a certificate, their paths below the group ``certificate``."""
    c = certificate
    items: Items = {name: np.array(getattr(c, name), dtype="<i8") for name in _PLACES}
    if c.doubtful:
        items["doubtful"] = np.array(c.doubtful, dtype="<i8")
    if c.open_boxes:
        items["open"] = np.array(c.open_boxes, dtype="<f8").reshape(
            len(c.open_boxes), len(c.order), 2
        )
    basis = rests_on(c)
    items["evidence/number"] = texts(list(basis))
    items["evidence/basis"] = texts(list(basis.values()))
    items["@max_relative_error"] = np.array(c.max_relative_error, dtype="<f8")
    items["@check_points"] = np.array(c.check_points, dtype="<i8")
    items["@seed"] = np.array(c.seed, dtype="<i8")
    items["@exact"] = np.array(c.exact, dtype=bool)
    items["@truncation_error"] = np.array(c.truncation_error, dtype="<f8")
    items["@well_posed"] = text_item(c.well_posed)
    if c.exact_bound:
        items["@exact_bound"] = np.array(True)  # noqa: FBT003
    if c.fit_error_bound > 0.0:
        items["@fit_error_bound"] = np.array(c.fit_error_bound, dtype="<f8")
    if c.order_bound > sum(c.lower_bound):
        items["@order_bound"] = np.array(c.order_bound, dtype="<i8")
    if c.condition > 0.0:
        items["@condition"] = np.array(c.condition, dtype="<f8")
        items["@sign_changes"] = np.array(c.sign_changes, dtype="<i8")
    if c.frequencies:
        items["@transfer_error"] = np.array(c.transfer_error, dtype="<f8")
        items["frequencies"] = np.array(c.frequencies, dtype="<f8")
    if c.by_terms:
        items["by_terms"] = np.array(c.by_terms, dtype="<i8")
    if c.near:
        items["near"] = texts(list(c.near))
    return items


def certificate_of(items: Items, sizes: tuple[int, ...]) -> Certificate:
    """The certificate of items whose paths begin with ``certificate``.

    `sizes` are the repetitions of the parameters in the model.

    Raises
    ------
    ArchiveError
        An attribute is missing that others need, or values do not agree.
    """
    names = [name for name in (*_ERRORS, *_COUNTS, "exact", "exact_bound", "order_bound")]
    given = {
        name: items[f"certificate@{name}"].item()
        for name in names
        if f"certificate@{name}" in items
    }
    if ("condition" in given) != ("sign_changes" in given):
        raise ArchiveError(
            "is not whole: 'condition' and 'sign_changes' of 'certificate': one is missing."
        )
    has_frequencies = "certificate/frequencies" in items
    if ("transfer_error" in given) != has_frequencies:
        absent = ("'certificate/frequencies'", "'transfer_error' of 'certificate'")
        raise ArchiveError(f"is not whole: {absent[has_frequencies]} is missing.")
    if not given["exact"] and "truncation_error" not in given:
        # the first files do not have it; what is in them is exact
        raise ArchiveError(
            "is not whole: the attribute 'truncation_error' of 'certificate' is missing."
        )
    places: dict[str, Any] = {name: integers(items, f"certificate/{name}") for name in _PLACES}
    doubtful = integers(items, "certificate/doubtful") if "certificate/doubtful" in items else ()
    boxes = floats(items, "certificate/open").tolist() if "certificate/open" in items else []
    by_frequency = floats(items, "certificate/frequencies") if "transfer_error" in given else None
    by_terms = items["certificate/by_terms"].tolist() if "certificate/by_terms" in items else []
    made = Certificate(
        **places,
        **given,
        doubtful=doubtful,
        well_posed=word(items, "certificate@well_posed", "sampled"),
        open_boxes=tuple(tuple((low, high) for low, high in box) for box in boxes),
        frequencies=() if by_frequency is None else tuple(by_frequency.tolist()),
        near=tuple(words(items, "certificate/near")) if "certificate/near" in items else (),
        by_terms=tuple((row, column) for row, column in by_terms),
    )
    _check(made, sizes)
    if "certificate/evidence/number" in items:
        stated = words(items, "certificate/evidence/number")
        basis = words(items, "certificate/evidence/basis")
        if len(set(stated)) != len(stated) or set(basis) - {PROVED, CHECKED, OPEN}:
            raise ArchiveError(
                "certificate/evidence: expected proved, checked or open for each number once."
            )
    return made


def _check(c: Certificate, sizes: tuple[int, ...]) -> None:
    """Raise an ArchiveError unless the values of a certificate can be true."""

    def needs(condition: bool, what: str) -> None:  # noqa: FBT001
        if not condition:
            raise ArchiveError(f"certificate: {what}.")

    needs(c.order == sizes, f"order is {c.order}, and the blocks of Delta have {sizes}")
    for name in (*_PLACES, "doubtful"):
        needs(min(getattr(c, name), default=0) >= 0, f"{name} has a negative number")
    for name in _COUNTS:
        needs(getattr(c, name) >= 0, f"{name} is {getattr(c, name)}, expected at least 0")
    for name in _ERRORS:
        value = getattr(c, name)
        needs(value >= 0.0, f"{name} is {value}, expected at least 0")
    for name in ("max_relative_error", "fit_error_bound", "transfer_error"):
        needs(math.isfinite(getattr(c, name)), f"{name} is {getattr(c, name)}, expected a number")
    if c.exact:
        above = [(a, b) for a, b in zip(c.lower_bound, c.order, strict=True) if a > b]
        needs(
            not above and c.order_bound <= sum(c.order),
            f"the lower bound {c.lower_bound}, together {c.order_bound}, is more than the order "
            f"{c.order} of a model that is exact",
        )
        needs(
            c.truncation_error == 0.0 == c.fit_error_bound,
            "exact is true, and there is an error of truncation or of a fit",
        )
    needs(
        c.well_posed in (PROVED, "sampled"),
        f"well_posed is {c.well_posed!r}, expected 'proved' or 'sampled'",
    )
    needs(not (c.well_posed == PROVED and c.open_boxes), "well_posed is 'proved', with open boxes")
    ends = (0.0, *c.frequencies, math.inf)
    needs(
        all(a < b for a, b in itertools.pairwise(ends)),
        f"frequencies are {c.frequencies}, expected larger and larger ones",
    )
    needs(
        all(row >= 0 and column >= 0 for row, column in c.by_terms),
        "by_terms has a negative number",
    )
    needs(
        all(low <= high for box in c.open_boxes for low, high in box),
        "an open box has a lower end above its upper end, or none",
    )
