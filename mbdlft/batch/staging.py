"""The folder of an unfinished sweep, beside its archive: one file for each finished shard.

A shard is a number of consecutive samples. Its file is complete or does not exist, and its numbers depend
on the plan of the sweep only: not on the process that computes them, nor on the time. So a sweep that was
killed continues with the shards that are missing. Behind the numbers of a shard is a SHA-256, and the
plan has one of itself and one of the source and the samples: what was changed meanwhile is computed
again, or is an error.
"""

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, ArchiveError
from mbdlft.base.threads import one_thread
from mbdlft.batch.compiled import fastest
from mbdlft.batch.rows import Source, source_of
from mbdlft.batch.samples import (
    GivenSamples,
    Samples,
    count_of,
    described,
    from_description,
    points_of,
)
from mbdlft.multibody.scene import Scene, scene_from_toml, scene_to_toml
from mbdlft.store import load, save
from mbdlft.store.sweep import pack
from mbdlft.system.model import LFTModel

_SHARD_ROWS, _SHARD_BYTES = 16384, 2**25
_PLAN, _SCENE, _MODEL, _SAMPLES = "plan.json", "scene.toml", "model.h5", "samples.npy"


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """The data from which shards are computed: the source of rows, the samples, and the shards' size."""

    source: Source
    samples: Samples
    shard_rows: int

    @property
    def count(self) -> int:
        """Number of samples."""
        return count_of(self.samples)

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.count // self.shard_rows)

    def rows_of(self, shard: int) -> int:
        """Number of samples of a shard."""
        return min(self.shard_rows, self.count - shard * self.shard_rows)


def work_of(given: Scene | LFTModel, samples: Samples) -> Work:
    """The work of a sweep in shards of whole chunks, small enough for memory and for regular progress."""
    source = fastest(source_of(given), count_of(samples))
    most = min(_SHARD_ROWS, _SHARD_BYTES // (8 * source.layout.width))
    return Work(source, samples, source.chunk * max(1, most // source.chunk))


def points_at(work: Work, shard: int) -> Array:
    """Samples (n, n_p) of a shard."""
    start = shard * work.shard_rows
    return points_of(work.samples, work.source.parameters, start, start + work.rows_of(shard))


def rows_at(source: Source, points: Array) -> Array:
    """Rows (n, width) at the samples `points` (n, n_p) of a shard.

    They are computed in chunks of the size that the source asks for, so that every process gets the same
    numbers.
    """
    with one_thread():
        parts = [
            pack(source.layout, part, *source.rows(part))
            for part in (
                points[start : start + source.chunk]
                for start in range(0, len(points), source.chunk)
            )
        ]
    return np.concatenate(parts)


def prepare(folder: Path, given: Scene | LFTModel, samples: Samples, *, restart: bool) -> Work:
    """Make the folder of a sweep, or continue with that of the same sweep.

    Raises
    ------
    AnalysisError
        The folder exists and belongs to another sweep that is not finished.
    ArchiveError
        The folder cannot be written.
    """
    work = work_of(given, samples)
    plan = {
        "mbdlft": version("mbdlft"),
        "source": "model" if isinstance(given, LFTModel) else "scene",
        "samples": described(samples),
        "shard_rows": work.shard_rows,
        "fingerprint": _fingerprint(given, samples),
    }
    with _written(folder):
        if restart or (folder.exists() and not (folder / _PLAN).exists()):
            clear(folder)
        if folder.exists():
            if _read_plan(folder) != plan:
                raise AnalysisError(
                    f"{folder}: another sweep of this name is not finished: its scene, samples or "
                    "version of mbdlft differ. Finish that one, give this one another name, or start "
                    "again (restart=True, --restart), which throws away what was computed."
                )
            return work
        folder.mkdir(parents=True)
        if isinstance(given, LFTModel):
            save(folder / _MODEL, given, "model")
        else:
            (folder / _SCENE).write_text(scene_to_toml(given), encoding="utf-8")
        if isinstance(samples, GivenSamples):
            np.save(folder / _SAMPLES, samples.points)
        _put(folder / _PLAN, json.dumps({"digest": _digest(plan), **plan}).encode())
    return work


def _read_plan(folder: Path) -> dict[str, Any]:
    """The plan of a sweep, without its digest.

    Raises
    ------
    ArchiveError
        The file was changed or cut.
    """
    try:
        plan: dict[str, Any] = json.loads((folder / _PLAN).read_bytes())
        if plan.pop("digest") == _digest(plan):
            return plan
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        pass
    raise _changed(folder / _PLAN)


def _digest(plan: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plan, sort_keys=True).encode()).hexdigest()


def _changed(file: Path) -> ArchiveError:
    """The error for a file of a sweep that is not what was written."""
    return ArchiveError(
        f"{file}: is damaged or was changed. Start the sweep again (restart=True, --restart), which "
        "throws away what was computed."
    )


def opened(folder: Path) -> Work:
    """The work of a sweep, as another process reads it from the folder.

    Raises
    ------
    ArchiveError
        A file of the folder was changed or cut.
    """
    plan = _read_plan(folder)
    given: Scene | LFTModel
    if plan["source"] == "model":
        given = load(folder / _MODEL, "model")
    else:
        try:
            given = scene_from_toml((folder / _SCENE).read_text(encoding="utf-8"))
        except UnicodeDecodeError:
            raise _changed(folder / _SCENE) from None
    try:
        samples = from_description(plan["samples"], folder / _SAMPLES)
    except FileNotFoundError:
        raise
    except (OSError, ValueError, EOFError):
        raise _changed(folder / _SAMPLES) from None
    if _fingerprint(given, samples) != plan["fingerprint"]:
        raise _changed(folder)  # the source or the samples
    return Work(fastest(source_of(given), count_of(samples)), samples, plan["shard_rows"])


def missing(folder: Path, work: Work) -> list[int]:
    """Shards that are not finished, or whose file is not what was written."""
    return [k for k in range(work.shards) if _rows(folder, work, k) is None]


def write_shard(folder: Path, shard: int, rows: Array) -> None:
    """Put the rows (n, width) of a shard into its file, which is then complete.

    Raises
    ------
    ArchiveError
        The file cannot be written.
    """
    with _written(folder):
        data = rows.astype("<f8").tobytes()
        _put(_shard(folder, shard), data + _seal(shard, data))


def _seal(shard: int, data: bytes) -> bytes:
    """The SHA-256 (32 bytes) of a shard, its number among what goes into it."""
    return hashlib.sha256(f"{shard}\n".encode() + data).digest()


def _rows(folder: Path, work: Work, shard: int) -> Array | None:
    """The rows (n, width) of a shard; None if they are not there as they were written."""
    try:
        image = _shard(folder, shard).read_bytes()
    except FileNotFoundError:
        return None
    data, shape = image[:-32], (work.rows_of(shard), work.source.layout.width)
    if len(data) != 8 * shape[0] * shape[1] or image[-32:] != _seal(shard, data):
        return None
    return np.frombuffer(data, dtype="<f8").reshape(shape)


def read_shards(folder: Path, work: Work) -> Iterator[Array]:
    """Yield the rows (n, width) of all shards in their order; one shard at a time is in memory.

    Raises
    ------
    ArchiveError
        The file of a shard is not what was written.
    """
    for k in range(work.shards):
        rows = _rows(folder, work, k)
        if rows is None:
            raise ArchiveError(
                f"{_shard(folder, k)}: is damaged or was changed. The same sweep computes it again."
            )
        yield rows


def clear(folder: Path) -> None:
    """Remove the folder, its plan first: a folder without plan, after a kill, is not continued."""
    with contextlib.suppress(FileNotFoundError):
        (folder / _PLAN).unlink()
    shutil.rmtree(folder, ignore_errors=True)


def _shard(folder: Path, shard: int) -> Path:
    """The file of a shard."""
    return folder / f"shard-{shard:07d}.f8"


def _put(file: Path, image: bytes) -> None:
    """Write a file beside the final one and rename it, so that the final one is always complete."""
    beside = file.with_name(f"{file.name}.{os.getpid()}")
    with beside.open("wb") as stream:
        stream.write(image)
        stream.flush()
        os.fsync(stream.fileno())
    beside.replace(file)


@contextlib.contextmanager
def _written(folder: Path) -> Iterator[None]:
    """A context in which failures of writing into the folder become an `ArchiveError`."""
    try:
        yield
    except OSError as error:
        raise ArchiveError(
            f"{folder}: cannot be written: {error.strerror or error}. What is finished stays there; "
            "the same sweep goes on from it."
        ) from None


def _fingerprint(given: Scene | LFTModel, samples: Samples) -> str:
    """A text that tells one pair of source and given samples from another."""
    digest = hashlib.sha256()
    if isinstance(given, LFTModel):
        digest.update(repr((given.parameters, given.states, given.inputs, given.outputs)).encode())
        for lft in (given.lft, given.trim.lft):
            if lft is not None:
                for matrix in (lft.M11, lft.M12, lft.M21, lft.M22):
                    digest.update(matrix.tobytes())
    else:
        digest.update(scene_to_toml(given).encode())
    if isinstance(samples, GivenSamples):
        digest.update(np.ascontiguousarray(samples.points).tobytes())
    return digest.hexdigest()
