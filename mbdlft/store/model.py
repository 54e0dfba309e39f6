"""One model as an HDF5 group: what docs/archive-format.md lists, checked on reading."""

from collections.abc import Sequence
from typing import Any, cast

import h5py
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import ArchiveError
from mbdlft.base.parameter import BilinearMap, Parameter
from mbdlft.base.signal import Signal
from mbdlft.lft.lft import LFT, Block
from mbdlft.system.model import Certificate, LFTModel, Provenance, Trim
from mbdlft.system.system import Parameters

TYPE, VERSION = "lft-model", "1.0"
_MATRICES = ("A", "B_w", "B_u", "C_z", "D_zw", "D_zu", "C_y", "D_yw", "D_yu")
_TEXT = h5py.string_dtype("utf-8")
_ULPS = 8.0  # between machines a tangent may differ in its last bits


def write_model(group: Any, model: LFTModel) -> None:
    """Write a model into an empty group."""
    group.attrs["encoding_type"] = TYPE
    group.attrs["encoding_version"] = VERSION
    group.attrs["time_domain"] = "continuous"
    if model.description:
        group.attrs["description"] = model.description
    for name in _MATRICES:
        _put(group, name, getattr(model, name))
    for name in ("states", "inputs", "outputs"):
        _write_signals(group.create_group(name), getattr(model, name))
    _put_indices(group.create_group("delta"), model.lft)
    _write_parameters(group.create_group("parameters"), model.parameters)
    trim = group.create_group("trim")
    _write_signals(trim, model.trim.signals)
    _put(trim, "nominal", model.trim.nominal)
    if model.trim.lft is not None:
        lft = trim.create_group("lft")
        for name, matrix in zip(
            ("D_zw", "D_zu", "D_yw", "D_yu"), _four(model.trim.lft), strict=True
        ):
            _put(lft, name, matrix)
        _put_indices(lft.create_group("delta"), model.trim.lft)
    certificate = group.create_group("certificate")
    for name in ("order", "lower_bound", "raw_order"):
        _put_numbers(certificate, name, np.array(getattr(model.certificate, name), dtype="<i8"))
    if model.certificate.doubtful:
        _put_numbers(certificate, "doubtful", np.array(model.certificate.doubtful, dtype="<i8"))
    certificate.attrs["max_relative_error"] = np.float64(model.certificate.max_relative_error)
    certificate.attrs["check_points"] = np.int64(model.certificate.check_points)
    certificate.attrs["seed"] = np.int64(model.certificate.seed)
    certificate.attrs["exact"] = np.bool_(model.certificate.exact)
    if model.certificate.exact_bound:
        certificate.attrs["exact_bound"] = np.bool_(model.certificate.exact_bound)
    certificate.attrs["truncation_error"] = np.float64(model.certificate.truncation_error)
    if model.certificate.fit_error_bound > 0.0:
        certificate.attrs["fit_error_bound"] = np.float64(model.certificate.fit_error_bound)
    if model.certificate.order_bound > sum(model.certificate.lower_bound):
        certificate.attrs["order_bound"] = np.int64(model.certificate.order_bound)
    if model.certificate.condition > 0.0:
        certificate.attrs["condition"] = np.float64(model.certificate.condition)
        certificate.attrs["sign_changes"] = np.int64(model.certificate.sign_changes)
    provenance = group.create_group("provenance")
    for name in Provenance.__dataclass_fields__:
        provenance.attrs[name] = getattr(model.provenance, name)


def _write_parameters(group: Any, parameters: Sequence[Parameter]) -> None:
    for name in ("name", "unit", "role", "substitution"):
        _put_text(group, name, [getattr(p, name) for p in parameters])
    for name in ("nominal", "low", "high", "reference"):
        _put(group, name, [getattr(p, name) for p in parameters])
    _put(group, "map", np.array([_row(p.map) for p in parameters]).reshape(-1, 3))


def _row(m: BilinearMap) -> tuple[float, float, float]:
    return (m.b0, m.b1, m.a1)


def _four(lft: LFT) -> tuple[Array, Array, Array, Array]:
    return (lft.M11, lft.M12, lft.M21, lft.M22)


def _write_signals(group: Any, signals: Sequence[Signal]) -> None:
    _put_text(group, "name", [signal.name for signal in signals])
    _put_text(group, "unit", [signal.unit for signal in signals])


def _put(group: Any, name: str, values: Any) -> None:
    _put_numbers(group, name, np.asarray(values, dtype="<f8"))


def _put_numbers(group: Any, name: str, values: NDArray[Any]) -> None:
    """Numbers with a checksum, which only chunks can have; nothing has none."""
    group.create_dataset(name, data=values, fletcher32=values.size > 0)


def _put_text(group: Any, name: str, texts: Sequence[str]) -> None:
    group.create_dataset(name, data=np.array(texts, dtype=object), shape=(len(texts),), dtype=_TEXT)


def _put_indices(group: Any, lft: LFT) -> None:
    rows = np.repeat(np.arange(len(lft.blocks)), [block.size for block in lft.blocks])
    _put_numbers(group, "parameter", rows.astype("<i8"))


def read_model(group: Any, name: str) -> LFTModel:
    """The model of a group.

    Raises
    ------
    ArchiveError, KeyError, ...
        Something is missing or has another shape than specified.
    """
    _check_encoding(group)
    parameters = _read_parameters(group["parameters"])
    states, inputs, outputs = (_read_signals(group[key]) for key in ("states", "inputs", "outputs"))
    blocks = _read_indices(group["delta"], parameters)
    rows = {"x": len(states), "u": len(inputs), "y": len(outputs)}
    rows["w"] = rows["z"] = sum(block.size for block in blocks)
    shapes = {"A": "xx", "B_w": "xw", "B_u": "xu", "C_z": "zx", "C_y": "yx"}
    M = {}
    for key in _MATRICES:
        shape = shapes.get(key, key[2:])
        M[key] = _get(group, key, (rows[shape[0]], rows[shape[1]]))
    return LFTModel(
        name=name,
        lft=LFT(
            M["D_zw"],
            np.hstack([M["C_z"], M["D_zu"]]),
            np.vstack([M["B_w"], M["D_yw"]]),
            np.block([[M["A"], M["B_u"]], [M["C_y"], M["D_yu"]]]),
            blocks,
        ),
        states=states,
        inputs=inputs,
        outputs=outputs,
        parameters=Parameters(parameters),
        trim=_read_trim(group["trim"], parameters),
        certificate=_read_certificate(group["certificate"], len(parameters)),
        provenance=Provenance(
            **{key: str(group["provenance"].attrs[key]) for key in Provenance.__dataclass_fields__}
        ),
        description=str(group.attrs.get("description", "")),
    )


def _check_encoding(group: Any) -> None:
    for key, expected in (("encoding_type", TYPE), ("time_domain", "continuous")):
        if group.attrs.get(key) != expected:
            raise ArchiveError(f"{key} is {group.attrs.get(key)!r}, expected {expected!r}.")
    version = group.attrs.get("encoding_version")
    major = version.partition(".")[0] if isinstance(version, str) else ""
    if not major.isdecimal():
        raise ArchiveError(f"encoding_version is {version!r}, expected {VERSION!r}.")
    if int(major) > int(VERSION.partition(".")[0]):
        raise ArchiveError(f"encoding_version is {version}, this mbdlft reads up to {VERSION}.")


def _read_parameters(group: Any) -> tuple[Parameter, ...]:
    names = _get_text(group, "name")
    count = len(names)
    texts = {key: _get_text(group, key, count) for key in ("unit", "role", "substitution")}
    numbers = {key: _get(group, key, (count,)) for key in ("nominal", "low", "high", "reference")}
    parameters = tuple(
        Parameter(
            names[k],
            float(numbers["nominal"][k]),
            float(numbers["low"][k]),
            float(numbers["high"][k]),
            unit=texts["unit"][k],
            role=cast(Any, texts["role"][k]),
            substitution=cast(Any, texts["substitution"][k]),
            reference=float(numbers["reference"][k]),
        )
        for k in range(count)
    )
    for parameter, row in zip(parameters, _get(group, "map", (count, 3)), strict=True):
        expected = np.array(_row(parameter.map))
        if not np.all(
            np.abs(row - expected) <= _ULPS * np.finfo(float).eps * np.max(np.abs(expected))
        ):
            raise ArchiveError(
                f"parameters/map of {parameter.name!r} is {row.tolist()}, but its range gives "
                f"{expected.tolist()}."
            )
    return parameters


def _read_trim(group: Any, parameters: Sequence[Parameter]) -> Trim:
    signals = _read_signals(group)
    nominal = tuple(float(value) for value in _get(group, "nominal", (len(signals),)))
    if "lft" not in group:
        return Trim(signals, nominal, None)
    inner = group["lft"]
    blocks = _read_indices(inner["delta"], parameters)
    n, m = sum(block.size for block in blocks), len(signals)
    D_zw, D_zu = _get(inner, "D_zw", (n, n)), _get(inner, "D_zu", (n, 1))
    D_yw, D_yu = _get(inner, "D_yw", (m, n)), _get(inner, "D_yu", (m, 1))
    return Trim(signals, nominal, LFT(D_zw, D_zu, D_yw, D_yu, blocks))


def _read_certificate(group: Any, count: int) -> Certificate:
    return Certificate(
        order=_get_integers(group, "order", count),
        lower_bound=_get_integers(group, "lower_bound", count),
        raw_order=_get_integers(group, "raw_order", count),
        max_relative_error=float(group.attrs["max_relative_error"]),
        check_points=int(group.attrs["check_points"]),
        seed=int(group.attrs["seed"]),
        exact=bool(group.attrs["exact"]),
        exact_bound=bool(group.attrs.get("exact_bound", False)),
        doubtful=_get_integers(group, "doubtful", count) if "doubtful" in group else (),
        truncation_error=_truncation_error(group),
        order_bound=int(group.attrs.get("order_bound", 0)),
        fit_error_bound=float(group.attrs.get("fit_error_bound", 0.0)),
        **_read_conditioning(group),
    )


def _read_conditioning(group: Any) -> dict[str, Any]:
    """Two attributes, or none in files that were written before there were any."""
    if not {"condition", "sign_changes"} & set(group.attrs):
        return {}
    return {
        "condition": float(group.attrs["condition"]),
        "sign_changes": int(group.attrs["sign_changes"]),
    }


def _truncation_error(group: Any) -> float:
    """The first files of format 1.0 do not have it; what is in them is exact."""
    if group.attrs["exact"] and "truncation_error" not in group.attrs:
        return 0.0
    return float(group.attrs["truncation_error"])


def _read_indices(group: Any, parameters: Sequence[Parameter]) -> tuple[Block, ...]:
    rows = group["parameter"][()]
    if (
        rows.ndim != 1
        or np.any(np.diff(rows) < 0)
        or np.any((rows < 0) | (rows >= len(parameters)))
    ):
        raise ArchiveError("delta/parameter is not sorted, or names a parameter that is not there.")
    counts = np.bincount(rows, minlength=len(parameters))
    return tuple(Block(p.name, int(count)) for p, count in zip(parameters, counts, strict=True))


def _read_signals(group: Any) -> tuple[Signal, ...]:
    names = _get_text(group, "name")
    return tuple(map(Signal, names, _get_text(group, "unit", len(names))))


def _get(group: Any, name: str, shape: tuple[int, ...]) -> Array:
    values = np.asarray(group[name][()], dtype=float)
    _check_shape(group, name, values.shape, shape)
    return values


def _get_integers(group: Any, name: str, count: int) -> tuple[int, ...]:
    values = group[name][()]
    _check_shape(group, name, values.shape, (count,))
    return tuple(int(value) for value in values)


def _get_text(group: Any, name: str, count: int | None = None) -> list[str]:
    texts = [str(text) for text in group[name].asstr()[()]]
    if count is not None:
        _check_shape(group, name, (len(texts),), (count,))
    return texts


def _check_shape(group: Any, name: str, found: tuple[int, ...], expected: tuple[int, ...]) -> None:
    if found != expected:
        raise ArchiveError(f"{group.name}/{name} has shape {found}, expected {expected}.")
