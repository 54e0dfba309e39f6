"""The archive: LFT models in HDF5, layout version 1.0 (docs/archive-format.md). Needs h5py and numpy.

Writing is atomic: the whole file is made in memory, written beside the old one and put in its place.
"""

import contextlib
import os
import tempfile
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np

from mbdlft.errors import ArchiveError, MbdlftError, unknown_name
from mbdlft.lft.lft import LFT, Array, Block
from mbdlft.lft.model import Certificate, LFTModel, Provenance, Trim
from mbdlft.parameter import BilinearMap, Parameter
from mbdlft.signal import Signal

FORMAT, VERSION, MODEL, MODEL_VERSION = "mbdlft-archive", "1.0", "lft-model", "1.0"
_MATRICES = ("A", "B_w", "B_u", "C_z", "D_zw", "D_zu", "C_y", "D_yw", "D_yu")
_TEXT = h5py.string_dtype("utf-8")


def save(path: str | Path, model: LFTModel, name: str | None = None) -> None:
    """Write a model into an archive under /models/<name>; the other contents of the file stay.

    Parameters
    ----------
    path : file, made if it does not exist
    model : LFTModel
    name : str, optional
        The name of the model by default; a model of that name is replaced.

    Raises
    ------
    ArchiveError
        The file exists and is not an archive of this major version, or it cannot be written. The
        old file is then unchanged.
    """
    file = Path(path)
    key = name or model.name
    if not key or "/" in key or key == ".":
        raise ArchiveError(f"{file}: {key!r} cannot name a model; a name has no '/'.")
    new = not file.exists()
    image = BytesIO() if new else _read_bytes(file)
    with _open_image(file, image, "w" if new else "r+") as archive:
        if new:
            archive.attrs["format"] = FORMAT
            archive.attrs["format_version"] = VERSION
        else:
            _check_format(file, archive)
        archive.attrs["generator"] = f"mbdlft {model.provenance.mbdlft}"
        models = archive.require_group("models")
        if key in models:
            del models[key]
        _write_model(models.create_group(key), model)
    _replace(file, image.getvalue())


def load(path: str | Path, name: str | None = None) -> LFTModel:
    """Read a model from an archive.

    Parameters
    ----------
    path : file
    name : str, optional
        May be left out when the archive has one model.

    Raises
    ------
    ArchiveError
        The file is missing, truncated, foreign or newer, or the model is not there or not whole.
    """
    file = Path(path)
    with _open_image(file, _read_bytes(file), "r") as archive:
        _check_format(file, archive)
        names = _model_names(archive)
        if name is None:
            if len(names) != 1:
                raise ArchiveError(
                    f"{file}: give the name of a model. Existing: {', '.join(names) or 'none'}."
                )
            name = names[0]
        if name not in names:
            raise ArchiveError(f"{file}: " + unknown_name("model", name, names))
        return _located(file, name, lambda: _read_model(archive["models"][name], str(name)))


def model_names(path: str | Path) -> tuple[str, ...]:
    """Names of the models in an archive, sorted.

    Parameters
    ----------
    path : file

    Raises
    ------
    ArchiveError
        The file is missing, truncated, foreign or newer.
    """
    file = Path(path)
    with _open_image(file, _read_bytes(file), "r") as archive:
        _check_format(file, archive)
        return _model_names(archive)


# files ------------------------------------------------------------------------------------------


def _read_bytes(file: Path) -> BytesIO:
    try:
        return BytesIO(file.read_bytes())
    except OSError as error:
        raise ArchiveError(f"{file}: cannot be read: {error.strerror}.") from None


def _open_image(file: Path, image: BytesIO, mode: str) -> Any:
    """An HDF5 file in memory."""
    try:
        return h5py.File(image, mode)
    except OSError as error:
        raise ArchiveError(
            f"{file}: is not a whole HDF5 file ({len(image.getvalue())} bytes): {error}. Write it "
            "again, or take it from a backup."
        ) from None


def _replace(file: Path, image: bytes) -> None:
    """Put a complete file in place of the old one, or leave the old one as it is."""
    temporary: Path | None = None
    try:
        handle, temporary_name = tempfile.mkstemp(prefix=f".{file.name}.", dir=file.parent)
        temporary = Path(temporary_name)
        with os.fdopen(handle, "wb") as stream:
            stream.write(image)
            stream.flush()
            os.fsync(stream.fileno())
        mode = file.stat().st_mode & 0o777 if file.exists() else 0o666 & ~_umask()
        temporary.chmod(mode)
        temporary.replace(file)
    except OSError as error:
        raise ArchiveError(
            f"{file}: cannot be written: {error.strerror or error}. The old file, if there was "
            "one, is unchanged."
        ) from None
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _check_format(file: Path, archive: Any) -> None:
    found = archive.attrs.get("format")
    if found != FORMAT:
        raise ArchiveError(
            f"{file}: is not an mbdlft archive: root attribute 'format' is {found!r}, "
            f"expected {FORMAT!r}."
        )
    version = str(archive.attrs.get("format_version", ""))
    major = version.partition(".")[0]
    if not major.isdigit():
        raise ArchiveError(f"{file}: 'format_version' is {version!r}, expected {VERSION!r}.")
    if int(major) > int(VERSION.partition(".")[0]):
        raise ArchiveError(
            f"{file}: has format version {version}, this mbdlft reads up to {VERSION}. Install a "
            "newer mbdlft."
        )


def _model_names(archive: Any) -> tuple[str, ...]:
    return tuple(sorted(archive["models"])) if "models" in archive else ()


def _located(file: Path, name: str, read: Callable[[], LFTModel]) -> LFTModel:
    """The result of `read`; whatever is missing or wrong inside becomes an `ArchiveError`."""
    try:
        return read()
    except ArchiveError as error:
        raise ArchiveError(f"{file}: model {name!r}: {error}") from None
    except KeyError as error:
        raise ArchiveError(f"{file}: model {name!r} is not whole: {error.args[0]}.") from None
    except (MbdlftError, OSError, ValueError, TypeError, AttributeError, IndexError) as error:
        raise ArchiveError(f"{file}: model {name!r} is not as specified: {error}") from None


# models -----------------------------------------------------------------------------------------


def _write_model(group: Any, model: LFTModel) -> None:
    group.attrs["encoding_type"] = MODEL
    group.attrs["encoding_version"] = MODEL_VERSION
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
        certificate.create_dataset(
            name, data=np.array(getattr(model.certificate, name), dtype="<i8")
        )
    certificate.attrs["max_relative_error"] = np.float64(model.certificate.max_relative_error)
    certificate.attrs["check_points"] = np.int64(model.certificate.check_points)
    certificate.attrs["seed"] = np.int64(model.certificate.seed)
    certificate.attrs["exact"] = np.bool_(model.certificate.exact)
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
    group.create_dataset(name, data=np.asarray(values, dtype="<f8"))


def _put_text(group: Any, name: str, texts: Sequence[str]) -> None:
    group.create_dataset(name, data=np.array(texts, dtype=object), shape=(len(texts),), dtype=_TEXT)


def _put_indices(group: Any, lft: LFT) -> None:
    rows = np.repeat(np.arange(len(lft.blocks)), [block.size for block in lft.blocks])
    group.create_dataset("parameter", data=rows.astype("<i8"))


def _read_model(group: Any, name: str) -> LFTModel:
    encoding = (group.attrs.get("encoding_type"), str(group.attrs.get("encoding_version")))
    if encoding[0] != MODEL:
        raise ArchiveError(f"encoding_type is {encoding[0]!r}, expected {MODEL!r}.")
    if int(encoding[1].partition(".")[0]) > int(MODEL_VERSION.partition(".")[0]):
        raise ArchiveError(
            f"encoding_version is {encoding[1]}, this mbdlft reads up to {MODEL_VERSION}."
        )
    blocks = {key: _get(group, key) for key in _MATRICES}
    parameters = _read_parameters(group["parameters"])
    trim, certificate = group["trim"], group["certificate"]
    attributes = certificate.attrs
    return LFTModel(
        name=name,
        lft=LFT(
            blocks["D_zw"],
            np.hstack([blocks["C_z"], blocks["D_zu"]]),
            np.vstack([blocks["B_w"], blocks["D_yw"]]),
            np.block([[blocks["A"], blocks["B_u"]], [blocks["C_y"], blocks["D_yu"]]]),
            _read_indices(group["delta"], parameters),
        ),
        states=_read_signals(group["states"]),
        inputs=_read_signals(group["inputs"]),
        outputs=_read_signals(group["outputs"]),
        parameters=parameters,
        trim=Trim(
            _read_signals(trim),
            tuple(float(value) for value in _get(trim, "nominal")),
            _read_trim_lft(trim["lft"], parameters) if "lft" in trim else None,
        ),
        certificate=Certificate(
            order=_get_integers(certificate, "order"),
            lower_bound=_get_integers(certificate, "lower_bound"),
            raw_order=_get_integers(certificate, "raw_order"),
            max_relative_error=float(attributes["max_relative_error"]),
            check_points=int(attributes["check_points"]),
            seed=int(attributes["seed"]),
            exact=bool(attributes["exact"]),
        ),
        provenance=Provenance(
            **{key: str(group["provenance"].attrs[key]) for key in Provenance.__dataclass_fields__}
        ),
        description=str(group.attrs.get("description", "")),
    )


def _read_parameters(group: Any) -> tuple[Parameter, ...]:
    texts = {key: _get_text(group, key) for key in ("name", "unit", "role", "substitution")}
    numbers = {key: _get(group, key) for key in ("nominal", "low", "high", "reference")}
    parameters = tuple(
        Parameter(
            texts["name"][k],
            float(numbers["nominal"][k]),
            float(numbers["low"][k]),
            float(numbers["high"][k]),
            unit=texts["unit"][k],
            role=cast(Any, texts["role"][k]),
            substitution=cast(Any, texts["substitution"][k]),
            reference=float(numbers["reference"][k]),
        )
        for k in range(len(texts["name"]))
    )
    for parameter, row in zip(parameters, _get(group, "map"), strict=True):
        if not np.array_equal(row, _row(parameter.map)):
            raise ArchiveError(
                f"parameters/map of {parameter.name!r} is {row.tolist()}, but its range gives "
                f"{list(_row(parameter.map))}."
            )
    return parameters


def _read_trim_lft(group: Any, parameters: Sequence[Parameter]) -> LFT:
    D_zw, D_zu, D_yw, D_yu = (_get(group, key) for key in ("D_zw", "D_zu", "D_yw", "D_yu"))
    return LFT(D_zw, D_zu, D_yw, D_yu, _read_indices(group["delta"], parameters))


def _read_indices(group: Any, parameters: Sequence[Parameter]) -> tuple[Block, ...]:
    rows = group["parameter"][()]
    if np.any(np.diff(rows) < 0) or np.any((rows < 0) | (rows >= len(parameters))):
        raise ArchiveError("delta/parameter is not sorted, or names a parameter that is not there.")
    counts = np.bincount(rows, minlength=len(parameters))
    return tuple(Block(p.name, int(count)) for p, count in zip(parameters, counts, strict=True))


def _read_signals(group: Any) -> tuple[Signal, ...]:
    return tuple(map(Signal, _get_text(group, "name"), _get_text(group, "unit")))


def _get(group: Any, name: str) -> Array:
    return np.asarray(group[name][()], dtype=float)


def _get_integers(group: Any, name: str) -> tuple[int, ...]:
    return tuple(int(value) for value in group[name][()])


def _get_text(group: Any, name: str) -> list[str]:
    return [str(text) for text in group[name].asstr()[()]]
