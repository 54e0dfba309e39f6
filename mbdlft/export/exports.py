"""Models as files of other tools, chosen by the ending of the name; all files of a call, or none."""

import contextlib
import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

from mbdlft.archive.archive import permissions_of, save, target_of
from mbdlft.base.errors import ArchiveError, StructureError
from mbdlft.export.grid import Counts, grid_csv, grid_mat, grid_npz, matrices_on
from mbdlft.export.names import RESERVED, identifier
from mbdlft.system.model import System
from mbdlft.system.theta import DeltaThetaModel

MODEL_SUFFIXES = (".mat", ".c", ".jl")
GRID_SUFFIXES = (".mat", ".csv", ".npz")
_ENDING = ".part"
_SIGNED, _HEAD = b"Written by mbdlft", 4096  # in the first bytes of every text
_WRITERS = {".mat": grid_mat, ".csv": grid_csv, ".npz": grid_npz}


def export_model(
    path: str | Path,
    model: System | DeltaThetaModel,
    counts: Counts | None = None,
    archive: str | Path | None = None,
) -> tuple[Path, ...]:
    """Write a model for another tool; the ending of the name says for which.

    Parameters
    ----------
    path : file
        ``.mat``: the numbers, with a script ``NAME.m`` and a function ``NAME_at.m`` beside it for MATLAB
        and Octave; ``.c``: C99, with a header; ``.jl``: a Julia script that reads an archive.
    model : LFTModel, System or DeltaThetaModel
        Of the last, derivatives and outputs with the nonlinear functions, too; for MATLAB in a third
        file ``NAME_rates.m``.
    counts : int, or mapping of names to int, optional
        Write state matrices at all combinations of so many evenly spaced values of each parameter
        (those that a mapping does not name are nominal) instead of the model: ``.mat``, ``.csv`` or
        ``.npz``.
    archive : file, optional
        For ``.jl``: where the model is stored under its name; else it is saved beside, as ``NAME.h5``.

    Returns
    -------
    tuple of Path
        The files that were written. All of them are complete, or the old ones are unchanged.

    Raises
    ------
    StructureError
        The ending or the name of the file is unknown to the tool, the model has complex or full blocks
        that it does not know, or names become the same.
    AnalysisError
        The grid is too large or is no grid, as in `lpv_grid`.
    ArchiveError
        A file cannot be written, or would take the place of one beside `path` that was not exported.
    """
    file = Path(path)
    if not isinstance(model, System | DeltaThetaModel):
        raise StructureError(
            f"{file}: expected an LFTModel, a System or a DeltaThetaModel, got {type(model).__name__}. "
            "to_lft(scene) makes one of a scene."
        )
    suffix = check_suffix(file, grid=counts is not None)
    if counts is not None:
        if isinstance(model, DeltaThetaModel):
            raise StructureError(
                f"{file}: model {model.name!r} has nonlinear functions, and no matrices on a grid. "
                "Linearize it around an equilibrium (linearize_dae), or export model.linear."
            )
        return _written({file: _WRITERS[suffix](model, matrices_on(model, counts))})
    if suffix == ".jl":
        return _written_julia(file, model, archive)
    return _written(_matlab(file, model) if suffix == ".mat" else _c(file, model))


def check_suffix(file: Path, *, grid: bool) -> str:
    """The ending of the name of a file.

    Raises
    ------
    StructureError
        It is not one of those that exist.
    """
    suffix = file.suffix.lower()
    known = GRID_SUFFIXES if grid else MODEL_SUFFIXES
    if suffix not in known:
        also = MODEL_SUFFIXES if grid else GRID_SUFFIXES
        here, there = ("a grid", "a model") if grid else ("a model", "a grid (--grid)")
        raise StructureError(
            f"{file}: unknown ending {suffix!r}. {here} is written as {', '.join(known)}; "
            f"{there} as {', '.join(also)}."
        )
    return suffix


def _matlab(file: Path, model: System | DeltaThetaModel) -> dict[Path, bytes]:
    """The .mat file, its script and its functions."""
    from mbdlft.export.matlab import evaluation_text, items_of_matlab, matlab_image, script_text
    from mbdlft.export.theta_matlab import items_of_theta_matlab, rates_text

    stem = file.stem
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,59}", stem) or stem in RESERVED:
        raise StructureError(
            f"{file}: {stem!r} cannot name a script of MATLAB, which is written beside it: ASCII "
            f"letters, digits and underscores, a letter first. Call it {identifier(stem)}.mat."
        )
    own: dict[Path, bytes] = {}
    linear: System = model.linear if isinstance(model, DeltaThetaModel) else model
    if isinstance(model, DeltaThetaModel):
        items = items_of_theta_matlab(model)
        own = {file.with_name(f"{stem}_rates.m"): rates_text(model, stem).encode()}
    else:
        items = items_of_matlab(linear)
    return {
        file: matlab_image(items),
        file.with_suffix(".m"): script_text(linear, stem).encode(),
        file.with_name(f"{stem}_at.m"): evaluation_text(linear, stem).encode(),
        **own,
    }


def _c(file: Path, model: System | DeltaThetaModel) -> dict[Path, bytes]:
    """The source and its header."""
    from mbdlft.export.c import c_texts
    from mbdlft.export.theta_c import theta_c_texts

    if isinstance(model, DeltaThetaModel):
        source, header = theta_c_texts(model, file.stem)
    else:
        source, header = c_texts(model, file.stem)
    return {file: source.encode(), file.with_suffix(".h"): header.encode()}


def _written_julia(
    file: Path, model: System | DeltaThetaModel, archive: str | Path | None
) -> tuple[Path, ...]:
    """The script, and the archive unless there is one."""
    from mbdlft.export.julia import julia_text
    from mbdlft.export.theta_julia import theta_julia_text

    beside = file.with_suffix(".h5")
    at = Path(archive) if archive is not None else beside
    try:
        place = os.path.relpath(at.resolve(), file.parent.resolve())
    except ValueError:  # on another drive
        place = str(at.resolve())
    if isinstance(model, DeltaThetaModel):
        text = theta_julia_text(model, file.stem, Path(place).as_posix())
    else:
        text = julia_text(model, file.stem, Path(place).as_posix())
    if archive is None:
        save(beside, model)
    return (*_written({file: text.encode()}), *((beside,) if archive is None else ()))


def _written(images: Mapping[Path, bytes]) -> tuple[Path, ...]:
    """Write all files, or none: each is made beside its place, then all are put there.

    Raises
    ------
    ArchiveError
        One of them cannot be written, or one beside the first, which was asked for, is not ours.
    """
    made: list[tuple[Path, Path]] = []
    file = next(iter(images))
    try:
        for file, image in images.items():
            target = target_of(file)
            if target.is_dir():
                raise IsADirectoryError(0, "it is a folder")
            if made and target.exists() and not _is_ours(target):
                raise FileExistsError(0, "it exists, and mbdlft has not written it")
            handle, name = tempfile.mkstemp(
                prefix=f".{target.name[:40]}.", suffix=_ENDING, dir=target.parent
            )
            made.append((Path(name), target))
            with os.fdopen(handle, "wb") as stream:
                stream.write(image)
                stream.flush()
                os.fsync(stream.fileno())
            Path(name).chmod(permissions_of(target))
        for temporary, target in made:
            temporary.replace(target)
    except OSError as error:
        if isinstance(error, ArchiveError):
            raise
        raise ArchiveError(
            f"{file}: cannot be written: {error.strerror or error}. Old files are unchanged."
        ) from None
    finally:
        for temporary, _ in made:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
    return tuple(images)


def _is_ours(file: Path) -> bool:
    """Whether a text was written by an export."""
    with file.open("rb") as stream:
        return _SIGNED in stream.read(_HEAD)
