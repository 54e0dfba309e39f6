"""MATLAB and Octave: the numbers of a model in a .mat file (version 5), and two m-files that use them.

Both run in Octave; the uncertain elements need the Robust Control Toolbox of MATLAB.
"""

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.parameter import DIVISORS, Parameter, to_internal
from mbdlft.base.unit import Signal
from mbdlft.export.names import check_different, filled, identifier, identifiers, one_line
from mbdlft.lft.lft import LFT
from mbdlft.system.model import LFTModel, System

_MATRICES = ("A", "B_w", "B_u", "C_z", "D_zw", "D_zu", "C_y", "D_yw", "D_yu")
_TANGENT = {"identity": "", "half-angle": "tan_half_", "quarter-angle": "tan_quarter_"}
_HEADER = 116  # bytes of text at the beginning of a file of version 5


def matlab_image(items: dict[str, Any]) -> bytes:
    """The bytes of a .mat file of version 5; equal for equal items, without the time and the machine."""
    from scipy.io import savemat

    stream = BytesIO()
    savemat(stream, items, format="5", oned_as="column", do_compression=True)
    return b"MATLAB 5.0 MAT-file, written by mbdlft".ljust(_HEADER) + stream.getvalue()[_HEADER:]


def items_of_matlab(model: System) -> dict[str, Any]:
    """Variables of the .mat file of a model: matrices, and structures of columns."""
    names = identifiers([block.name for block in model.lft.blocks], f"model {model.name!r}: MATLAB")
    items: dict[str, Any] = {
        "format": "mbdlft-mat/1",
        "name": model.name,
        "description": model.description,
        **{name: getattr(model, name) for name in _MATRICES},
        "states": signals(model.states),
        "inputs": signals(model.inputs),
        "outputs": signals(model.outputs),
        "delta": _blocks(model.lft, model.parameters, names),
        "parameters": _parameters(model, names),
    }
    if isinstance(model, LFTModel):
        lft = model.trim.lft
        items["trim"] = {**signals(model.trim.signals), "nominal": column(model.trim.nominal)}
        if lft is not None:
            items["trim"]["lft"] = {
                "D_zw": lft.M11,
                "D_zu": lft.M12,
                "D_yw": lft.M21,
                "D_yu": lft.M22,
                "delta": _blocks(lft, model.parameters, names),
            }
    return items


def cells(texts: Sequence[str]) -> Any:
    """A column of texts, which MATLAB calls a cell array."""
    column = np.empty((len(texts), 1), dtype=object)
    column[:, 0] = texts
    return column


def column(numbers: Sequence[float]) -> Array:
    """Numbers as a column (n, 1)."""
    return np.asarray(numbers, dtype=float).reshape(-1, 1)


def signals(listed: Sequence[Signal]) -> dict[str, Any]:
    """Names and units of signals as columns."""
    return {"name": cells([s.name for s in listed]), "unit": cells([s.unit for s in listed])}


def _blocks(lft: LFT, parameters: Sequence[Parameter], names: dict[str, str]) -> dict[str, Any]:
    """The blocks of Delta; `parameter` is the number of each in the parameters from 1 on, or 0."""
    numbers = {p.name: k for k, p in enumerate(parameters, start=1)}
    return {
        "name": cells([b.name for b in lft.blocks]),
        "identifier": cells([names[b.name] for b in lft.blocks]),
        "kind": cells([b.kind for b in lft.blocks]),
        "rows": column([b.outputs for b in lft.blocks]),
        "columns": column([b.inputs for b in lft.blocks]),
        "parameter": column([numbers.get(b.name, 0) for b in lft.blocks]),
    }


def _parameters(model: System, names: dict[str, str]) -> dict[str, Any]:
    """The parameters, with the maps from physical values to deltas."""
    parameters = model.parameters
    elements = {p.name: _TANGENT[p.substitution] + names[p.name] for p in parameters}
    others = {b.name: names[b.name] for b in model.lft.blocks if b.kind != "real"}
    check_different({**elements, **others}, f"model {model.name!r}: uncertain elements of MATLAB")
    table: dict[str, Any] = {
        "name": cells([p.name for p in parameters]),
        "identifier": cells([names[p.name] for p in parameters]),
        "element": cells([elements[p.name] for p in parameters]),
    }
    for name in ("unit", "role", "substitution"):
        table[name] = cells([getattr(p, name) for p in parameters])
    for name in ("nominal", "low", "high", "reference"):
        table[name] = column([getattr(p, name) for p in parameters])
    internal = [to_internal(p, [p.low, p.nominal, p.high]) for p in parameters]
    maps = [(p.map.b0, p.map.b1, p.map.a1) for p in parameters]
    return {
        **table,
        # what one unit is inside the tangent, rad; 1 without a substitution
        "factor": column([p.factor if p.is_angle else 1.0 for p in parameters]),
        "divisor": column([DIVISORS[p.substitution] for p in parameters]),
        "internal": np.array(internal).reshape(-1, 3),
        "map": np.array(maps).reshape(-1, 3),
        "gain": column([p.map.gain for p in parameters]),
    }


def m_texts(model: System, stem: str) -> tuple[str, str]:
    """The script of the .mat file, and the function that evaluates it at physical values.

    The script makes an uncertain system, or plain matrices.
    """
    table = "\n".join(table_of(model, "%   "))
    entries = {"stem": stem, "model": one_line(model.name), "table": table}
    return filled("model.m", entries), filled("model_at.m", entries)


def table_of(model: System, begin: str, shown: dict[str, str] | None = None) -> list[str]:
    """Lines of a comment: which name became which, ranges and units, and the signals."""
    rows = [("name there", "name in mbdlft", "low", "nominal", "high", "unit")]
    for p in model.parameters:
        name = (shown or {}).get(p.name, identifier(p.name))
        rows.append((name, p.name, f"{p.low:.7g}", f"{p.nominal:.7g}", f"{p.high:.7g}", p.unit))
    for block in model.lft.blocks:
        if block.kind != "real":
            size = f"{block.outputs} x {block.inputs}"
            rows.append((identifier(block.name), block.name, "", "0", "", f"{block.kind}, {size}"))
    widths = [max(map(len, entries)) + 2 for entries in zip(*rows, strict=True)]
    lines = ["".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) for row in rows]
    if len(rows) == 1:
        lines = ["(no parameters)"]
    kinds = [("states", model.states), ("inputs", model.inputs), ("outputs", model.outputs)]
    if isinstance(model, LFTModel):
        kinds.append(("trim", model.trim.signals))
    for what, signals in kinds:
        listed = ", ".join(f"{s.name} ({s.unit})" for s in signals) or "none"
        lines.append(f"{what}: {listed}")
    return [f"{begin}{one_line(line)}".rstrip() for line in lines]
