"""One model or system as the items of an HDF5 group, and back: docs/archive-format.md.

Numbers that are not independent of each other (the map of a parameter, rows of blocks, the evidence of a
certificate) are for readers in other languages, and must agree when they are read.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbdlft.archive import layout
from mbdlft.archive.hdf5 import FAILURES
from mbdlft.archive.program import coded, program_of_items, theta_of_items, theta_values
from mbdlft.base.errors import ArchiveError, MbdlftError
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Signal
from mbdlft.lft.block import ComplexBlock, FullBlock
from mbdlft.lft.lft import LFT, Block
from mbdlft.lft.sparse import SparseLFT
from mbdlft.system.model import Certificate, LFTModel, Parameters, Provenance, System, Trim
from mbdlft.system.theta import DeltaThetaModel

KINDS = (layout.MODEL_TYPE, layout.SYSTEM_TYPE)
PROVED, CHECKED, OPEN = "proved", "checked", "open"
_SIGNALS = ("states", "inputs", "outputs")
_FOUR = {"D_zw": "M11", "D_zu": "M12", "D_yw": "M21", "D_yu": "M22"}
_TEXTS = ("name", "unit", "role", "substitution")
_NUMBERS = ("nominal", "low", "high", "reference")
_ULPS = 8.0  # between machines a tangent may differ in its last bit
_POINTER = "in the dataset provenance/scene"  # where readers of 1.0 look for the text


def items_of_model(model: System | DeltaThetaModel) -> layout.Items:
    """The items of a model or a system, and of its nonlinear functions, with their digest."""
    values: dict[str, Any] = {}
    if isinstance(model, DeltaThetaModel):
        values, model = theta_values(model), model.linear
    kind = layout.MODEL_TYPE if isinstance(model, LFTModel) else layout.SYSTEM_TYPE
    is_sparse = isinstance(model.lft, SparseLFT)  # has matrices as values only, which are not stored
    values |= layout.of_fields("", kind, model, layout.MATRICES if is_sparse else ())
    values |= {"@time_domain": "continuous", "@description": model.description or None}
    for name in _SIGNALS:
        values |= signal_values(name, getattr(model, name))
    values |= _block_values("delta", model.lft, model.parameters)
    if is_sparse:
        values |= layout.of_fields("sparse", kind, model.lft)
    values |= layout.columns("parameters", (*_TEXTS, *_NUMBERS), model.parameters)
    values["parameters/map"] = [_row(p) for p in model.parameters]
    if isinstance(model, LFTModel):
        values |= {**signal_values("trim", model.trim.signals), "trim/nominal": model.trim.nominal}
        if (held := model.trim.lft) is not None:
            values |= {f"trim/lft/{name}": getattr(held, M) for name, M in _FOUR.items()}
            values |= _block_values("trim/lft/delta", held, model.parameters)
        values |= _certificate_values(model.certificate)
        values |= layout.of_fields("provenance", kind, model.provenance)
        values["provenance@scene"] = _POINTER
        if (known := model.known_program) is not None:
            program = coded(known.program, known.row)
            values |= {f"program/{name}": array for name, array in program.items()}
    return layout.with_digest(layout.encode(kind, values))


def signal_values(group: str, signals: Sequence[Signal]) -> dict[str, Any]:
    """Names and units of signals, by path."""
    return layout.columns(group, ("name", "unit"), signals)


def _row(p: Parameter) -> tuple[float, float, float]:
    return p.map.b0, p.map.b1, p.map.a1


def _block_values(group: str, lft: LFT, parameters: Sequence[Parameter]) -> dict[str, Any]:
    """The blocks of Delta, and of each of its rows the parameter; -1 where there is none."""
    place = {p.name: k for k, p in enumerate(parameters)}
    return {
        **layout.columns(group, ("name", "kind"), lft.blocks),
        f"{group}/rows": [block.outputs for block in lft.blocks],
        f"{group}/columns": [block.inputs for block in lft.blocks],
        f"{group}/parameter": [
            place[b.name] if b.kind == "real" else -1 for b in lft.blocks for _ in range(b.outputs)
        ],
    }


def model_of_items(items: layout.Items, name: str) -> System | DeltaThetaModel:
    """The model or system of the items of a group, which agree with the table."""
    if layout.word(items, "@encoding_version") != layout.FIRST:
        layout.check_digest(items)
    domain = layout.word(items, "@time_domain")
    if domain != "continuous":
        raise ArchiveError(f"time_domain is {domain!r}, expected 'continuous'.")
    try:
        model = _system(items, name)
        if isinstance(model, LFTModel) and "theta/name" in items:
            return theta_of_items(items, model)
        return model
    except ArchiveError:
        raise
    except (MbdlftError, *FAILURES) as error:
        raise ArchiveError(f"is not as specified: {error}") from None


def _system(items: layout.Items, name: str) -> System:
    parameters = _parameters(items)
    blocks = _blocks(items, "delta", parameters)
    lft = _lft(items, blocks)
    common: dict[str, Any] = {
        "name": name,
        "lft": lft,
        **{key: signals_of(items, key) for key in _SIGNALS},
        "parameters": Parameters(parameters),
        "description": layout.word(items, "@description"),
    }
    if layout.word(items, "@encoding_type") == layout.SYSTEM_TYPE:
        return System(**common)
    sizes = tuple(block.size for block in blocks if block.kind == "real")
    trim = _trim(items, parameters)
    scene = layout.long_text(items, "provenance/scene", "provenance@scene")
    return LFTModel(
        **common,
        trim=trim,
        program=program_of_items(items, parameters, lft, trim.lft),
        certificate=_certificate(items, sizes),
        provenance=layout.record(Provenance, items, "provenance", scene=scene),
    )


def _lft(M: layout.Items, blocks: tuple[Block, ...]) -> LFT:
    if "sparse/entry" not in M:
        if "A" not in M:
            raise ArchiveError("is not whole: the dataset 'A' is missing.")
        return LFT(
            M["D_zw"],
            np.hstack([M["C_z"], M["D_zu"]]),
            np.vstack([M["B_w"], M["D_yw"]]),
            np.block([[M["A"], M["B_u"]], [M["C_y"], M["D_yu"]]]),
            blocks,
        )
    states, inputs, outputs = (len(M[f"{name}/name"]) for name in _SIGNALS)
    row, column, entry, block = (M[f"sparse/{name}"] for name in ("row", "column", "entry", "block"))
    shape = (states + outputs, states + inputs)
    signals, nonzero = int(M["sparse@signals"]), M["sparse/nonzero"]
    return SparseLFT(row, column, entry, block, signals, shape, blocks, nonzero)


def _parameters(items: layout.Items) -> tuple[Parameter, ...]:
    layout.unique_names(items, "parameters")
    parameters = []
    for *labels, nominal, low, high, reference, row in layout.rows_of(
        items, "parameters", (*_TEXTS, *_NUMBERS, "map")
    ):
        texts: dict[str, Any] = dict(zip(_TEXTS, labels, strict=True))
        p = Parameter(**texts, nominal=nominal, low=low, high=high, reference=reference)
        expected = np.array(_row(p))
        if not np.all(np.abs(row - expected) <= _ULPS * np.finfo(float).eps * np.max(np.abs(expected))):
            raise ArchiveError(
                f"parameters/map of {p.name!r} is {row}, but its range gives {expected.tolist()}."
            )
        parameters.append(p)
    return tuple(parameters)


def _trim(items: layout.Items, parameters: Sequence[Parameter]) -> Trim:
    signals, nominal = signals_of(items, "trim"), tuple(items["trim/nominal"].tolist())
    if "trim/lft/D_zw" not in items:
        return Trim(signals, nominal, None)
    blocks = _blocks(items, "trim/lft/delta", parameters)
    M11, M12, M21, M22 = (items[f"trim/lft/{name}"] for name in _FOUR)
    return Trim(signals, nominal, LFT(M11, M12, M21, M22, blocks))


def _blocks(items: layout.Items, group: str, parameters: Sequence[Parameter]) -> tuple[Block, ...]:
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
        _block(*row) for row in layout.rows_of(items, group, ("name", "kind", "rows", "columns"))
    )
    heights = [block.outputs for block in blocks]
    if min(heights, default=0) < 0 or sum(heights) != len(rows):
        raise ArchiveError(f"{group}/rows: expected {len(rows)} together, as many as channels.")
    place = {p.name: k for k, p in enumerate(parameters)}
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


def signals_of(items: layout.Items, group: str) -> tuple[Signal, ...]:
    """The signals of a group such as ``states``; each name occurs once."""
    return tuple(map(Signal, layout.unique_names(items, group), layout.words(items, f"{group}/unit")))


def rests_on(certificate: Certificate) -> dict[str, str]:
    """What each number of a certificate rests on, by name.

    "proved": exact or outward-rounded arithmetic; "checked": floating point, or at points; or "open".
    """
    c = certificate
    basis = {
        "lower_bound": PROVED if c.exact_bound else CHECKED,
        "max_relative_error": CHECKED,
        "well_posed": PROVED if c.well_posed == PROVED else OPEN if c.open_boxes else CHECKED,
    }
    if c.truncation_error > 0.0:
        basis["truncation_error"] = OPEN if math.isinf(c.truncation_error) else PROVED
    if c.fit_error_bound > 0.0:
        basis["fit_error_bound"] = PROVED
    if c.condition > 0.0:
        basis["condition"] = CHECKED
    if c.frequencies:
        basis["transfer_error"] = CHECKED
    return dict(sorted(basis.items()))


def _certificate_values(c: Certificate) -> dict[str, Any]:
    """Values by path; what a certificate does not have is left out, and so is a bound that is a sum."""
    optional = (
        "doubtful",
        "exact_bound",
        "fit_error_bound",
        "condition",
        "by_terms",
        "near",
        "accelerations",
        "momenta",
        "rigid_motions",
        "unmoved",
        "driven",
        "beside",
        "frequencies",
    )
    absent = {name for name in optional if not getattr(c, name)}
    absent |= {"sign_changes"} if "condition" in absent else set()
    absent |= set() if c.condition or c.rounding_ratio else {"rounding_ratio"}
    absent |= {"transfer_error"} if "frequencies" in absent else set()
    absent |= {"order_bound"} if c.order_bound == sum(c.lower_bound) else set()
    basis = rests_on(c)
    values = layout.of_fields("certificate", layout.MODEL_TYPE, c)
    return {
        **{path: value for path, value in values.items() if path[12:] not in absent},
        "certificate/open": c.open_boxes or None,
        "certificate/evidence/number": list(basis),
        "certificate/evidence/basis": list(basis.values()),
    }


def _certificate(items: layout.Items, sizes: tuple[int, ...]) -> Certificate:
    """The certificate; `sizes` are the repetitions of the parameters in the model."""
    if not items["certificate@exact"] and "certificate@truncation_error" not in items:
        # the first files do not have it; what is in them is exact
        raise ArchiveError("is not whole: the attribute 'truncation_error' of 'certificate' is missing.")
    boxes = items["certificate/open"].tolist() if "certificate/open" in items else []
    certificate = layout.record(Certificate, items, "certificate", open_boxes=layout.nested(boxes))
    _check(certificate, sizes, *(len(items[f"{side}/name"]) for side in ("outputs", "inputs", "states")))
    if "certificate/evidence/number" in items:
        stated = layout.words(items, "certificate/evidence/number")
        basis = layout.words(items, "certificate/evidence/basis")
        if len(set(stated)) != len(stated) or set(basis) - {PROVED, CHECKED, OPEN}:
            raise ArchiveError(
                "certificate/evidence: expected proved, checked or open for each number once."
            )
    return certificate


def _check(c: Certificate, sizes: tuple[int, ...], outputs: int, inputs: int, states: int) -> None:
    """Raise an ArchiveError unless the values of a certificate can be true."""

    def needs(condition: bool, what: str) -> None:  # noqa: FBT001
        if not condition:
            raise ArchiveError(f"certificate: {what}.")

    needs(c.order == sizes, f"order is {c.order}, and the blocks of Delta have {sizes}")
    for name in ("order", "lower_bound", "raw_order", "doubtful"):
        needs(min(getattr(c, name), default=0) >= 0, f"{name} has a negative number")
    errors = ("max_relative_error", "fit_error_bound", "transfer_error", "rounding_ratio")
    counts = ("check_points", "seed", "sign_changes")
    for name in (*errors, "truncation_error", "condition", *counts):
        value = getattr(c, name)
        needs(value >= 0, f"{name} is {value}, expected at least 0")
    for name in errors:
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
    needs(all(row >= 0 and column >= 0 for row, column in c.by_terms), "by_terms has a negative number")
    needs(all(0 <= k < outputs for k in c.accelerations), f"accelerations: there are {outputs} outputs")
    needs(len({*c.momenta} - {0}) < 2 and min(c.momenta, default=0) >= 0, "momenta has several numbers")
    needs(len({*map(abs, c.rigid_motions)}) < 2, "rigid_motions has several numbers")
    needs(
        all(0 <= i < outputs and 0 <= j < inputs for i, j in c.unmoved),
        f"unmoved: there are {outputs} outputs and {inputs} inputs",
    )
    for name in ("driven", "beside"):
        some = getattr(c, name)
        needs(all(0 <= k < states for k in some), f"{name}: there are {states} states")
    needs(
        all(low <= high for box in c.open_boxes for low, high in box),
        "an open box has a lower end above its upper end, or none",
    )
