"""The folder of an unfinished sweep, beside its archive: the rows, and a note for each finished shard.

A shard is a number of consecutive samples. Its rows have their place in the file that becomes the
archive, and its note has the SHA-256 of each of its blocks: what is not noted, or is not what the note
says, is computed again. Rows depend on the plan of the sweep only: not on the process that computes them,
nor on the time. So a sweep that was killed continues with the shards that are missing. The plan has a
SHA-256 of itself and one of the source and the samples: what was changed meanwhile is an error.
"""

import contextlib
import hashlib
import json
import os
import shutil
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.archive import sweep
from mbdlft.archive.archive import load, save, writing
from mbdlft.archive.layout import DIGEST
from mbdlft.archive.model import items_of_model
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, ArchiveError
from mbdlft.base.running import one_thread
from mbdlft.batch.rows import EquationSource, Extra, ModelSource, Source, extras, source_digest, source_of
from mbdlft.batch.samples import GivenSamples, Samples, count_of, described, from_description, points_of
from mbdlft.multibody.scene import Scene, scene_from_toml, scene_to_toml
from mbdlft.system.model import LFTModel

_SHARD_ROWS, _SHARD_BYTES = 16384, 2**25  # of a shard: seconds of work at most, 32 MB of memory
_BLOCK_ROWS = 4096  # a digest (32 bytes) for each so many rows
_PLAN, _SCENE, _MODEL, _SAMPLES = "plan.json", "scene.toml", "model.h5", "samples.npy"


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """The data from which shards are computed."""

    source: EquationSource | ModelSource  # the definition; `fastest` of it computes
    samples: Samples
    extra: Extra  # what is computed besides
    block_rows: int  # a block has a digest
    shard_rows: int  # a shard has whole blocks
    plan: str  # its digest

    @property
    def layout(self) -> sweep.Layout:
        """That of the rows."""
        return self.extra.layout(self.source.layout)

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


def points_at(work: Work, shard: int) -> Array:
    """Samples (n, n_p) of a shard."""
    start = shard * work.shard_rows
    return points_of(work.samples, work.source.parameters, start, start + work.rows_of(shard))


def rows_at(source: Source, chunk: int, extra: Extra, points: Array) -> Array:
    """Rows (n, width) at the samples `points` (n, n_p) of a shard.

    They are computed in chunks of one size, so that every process gets the same numbers.
    """
    layout = extra.layout(source.layout)
    rows = np.empty((len(points), layout.width))
    with one_thread():
        for start in range(0, len(points), chunk):
            chunk_points = points[start : start + chunk]
            matrices, trim, residual, status = source.rows(chunk_points)
            more = extras(extra, source.layout, chunk_points, matrices, trim, status)
            datasets = {
                "samples": chunk_points,
                **layout.parts(matrices),
                "trim/value": trim,
                "residual": residual,
                "status": status,
                **more,
            }
            sweep.pack(layout, datasets, rows[start : start + chunk])
    return rows


def prepare(
    folder: Path, definition: Scene | LFTModel, samples: Samples, extra: Extra, *, restart: bool
) -> Work:
    """Make the folder of a sweep, or continue with that of the same sweep.

    Shards are whole chunks, small enough for memory and for regular progress.
    """
    source = source_of(definition)
    block = source.chunk * max(1, min(_BLOCK_ROWS, _SHARD_ROWS) // source.chunk)
    most = min(_SHARD_ROWS, _SHARD_BYTES // (8 * extra.layout(source.layout).width))
    shard = block * max(1, most // block)
    plan = {
        "mbdlft": version("mbdlft"),
        "source": "model" if isinstance(definition, LFTModel) else "scene",
        "samples": described(samples),
        "extra": json.loads(json.dumps(asdict(extra))),
        "function": source_digest(extra.function),
        "block_rows": block,
        "shard_rows": shard,
        "fingerprint": _fingerprint(definition, samples),
    }
    work = Work(source, samples, extra, block, shard, _digest(plan))
    with _written(folder):
        if restart or (folder.exists() and not (folder / _PLAN).exists()):
            clear(folder)
        if folder.exists():
            if _read_plan(folder) != plan:
                raise AnalysisError(
                    f"{folder}: another sweep of this name is not finished: its scene, samples, function "
                    "or version of mbdlft differ. Finish that one, give this one another name, or start "
                    "again (restart=True, --restart), which throws away what was computed."
                )
            _make_rows(folder, work)
            return work
        folder.mkdir(parents=True)
        if isinstance(definition, LFTModel):
            save(folder / _MODEL, definition, "model")
        else:
            (folder / _SCENE).write_text(scene_to_toml(definition), encoding="utf-8")
        if isinstance(samples, GivenSamples):
            np.save(folder / _SAMPLES, samples.points)
        _make_rows(folder, work)
        _put(folder / _PLAN, json.dumps({"digest": work.plan, **plan}).encode())
    return work


def _read_plan(folder: Path) -> dict[str, Any]:
    """The plan of a sweep, without its digest."""
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
    """The work of a sweep, as another process reads it from the folder."""
    plan = _read_plan(folder)
    definition: Scene | LFTModel
    if plan["source"] == "model":
        definition = load(folder / _MODEL, "model")
    else:
        try:
            definition = scene_from_toml((folder / _SCENE).read_text(encoding="utf-8"))
        except UnicodeDecodeError:
            raise _changed(folder / _SCENE) from None
    try:
        samples = from_description(plan["samples"], folder / _SAMPLES)
    except FileNotFoundError:
        raise
    except (OSError, ValueError, EOFError):
        raise _changed(folder / _SAMPLES) from None
    if _fingerprint(definition, samples) != plan["fingerprint"]:
        raise _changed(folder)  # the source or the samples
    asked = {**plan["extra"], "names": tuple(plan["extra"]["names"])}
    source = source_of(definition)
    return Work(source, samples, Extra(**asked), plan["block_rows"], plan["shard_rows"], _digest(plan))


def rows_file(folder: Path) -> Path:
    """The file with the rows of a sweep."""
    return folder / "rows.h5"


def places(folder: Path, work: Work) -> sweep.Places:
    """Where rows are in their file."""
    return sweep.places_in(rows_file(folder), work.layout, work.count)


def _make_rows(folder: Path, work: Work) -> None:
    """Make the file of rows; if there is one, it keeps its rows, and the rest of it is made anew."""
    file, fresh = rows_file(folder), folder / "fresh.h5"
    if not file.exists():
        sweep.check_room(folder, work.layout, work.count)
    made = sweep.make_rows(fresh, work.layout, work.count)
    if not file.exists():
        try:
            sweep.reserve(fresh)
        except OSError:
            fresh.unlink()
            raise
        fresh.replace(file)
        return
    sweep.restore(file, fresh, made)
    fresh.unlink()


def missing(folder: Path, work: Work) -> list[int]:
    """Shards that are not finished, or whose rows are not what was noted."""
    shards, at, file = [], places(folder, work), rows_file(folder)
    for shard in range(work.shards):
        noted = _noted(folder, work, shard)
        if noted is not None:
            rows = at.read(file, shard * work.shard_rows, work.rows_of(shard))
            if np.array_equal(sweep.digests_of(rows, work.block_rows), noted):
                continue
        shards.append(shard)
    return shards


def write_shard(folder: Path, work: Work, at: sweep.Places, shard: int, rows: Array) -> None:
    """Put the rows (n, width) of a shard to their places, and note that it is finished."""
    with _written(folder):
        at.write(rows_file(folder), shard * work.shard_rows, rows)
        noted = sweep.digests_of(rows, work.block_rows).tobytes()
        # not forced to the disk: what is noted is compared with the rows
        _put(_note(folder, shard), noted + _seal(work, shard, noted), now=False)


def _seal(work: Work, shard: int, noted: bytes) -> bytes:
    """The SHA-256 (32 bytes) of the note of a shard, with its number and its plan.

    A worker whose sweep was killed may write once more, when the folder has another plan by then.
    """
    return hashlib.sha256(f"{work.plan}\n{shard}\n".encode() + noted).digest()


def _noted(folder: Path, work: Work, shard: int) -> NDArray[np.uint8] | None:
    """The digests (., 32) of the blocks of a shard; None if they are not there as they were written."""
    try:
        image = _note(folder, shard).read_bytes()
    except FileNotFoundError:
        return None
    noted, blocks = image[:-32], -(-work.rows_of(shard) // work.block_rows)
    if len(noted) != 32 * blocks or image[-32:] != _seal(work, shard, noted):
        return None
    return np.frombuffer(noted, dtype=np.uint8).reshape(-1, 32)


def blocks_of(folder: Path, work: Work) -> NDArray[np.uint8]:
    """The digests (., 32) of all blocks."""
    digests = []
    for shard in range(work.shards):
        noted = _noted(folder, work, shard)
        if noted is None:
            raise ArchiveError(
                f"{_note(folder, shard)}: is damaged or was changed. The same sweep computes it again."
            )
        digests.append(noted)
    return np.concatenate(digests)


def clear(folder: Path) -> None:
    """Remove the folder, under another name: workers of a killed sweep do not write into it any more."""
    gone = folder.with_name(f"{folder.name}.gone")
    shutil.rmtree(gone, ignore_errors=True)  # of a kill
    with contextlib.suppress(FileNotFoundError):
        folder.rename(gone)
    shutil.rmtree(gone, ignore_errors=True)


def _note(folder: Path, shard: int) -> Path:
    """The note of a shard."""
    return folder / f"shard-{shard:07d}.sha256"


def _put(file: Path, image: bytes, *, now: bool = True) -> None:
    """Write a file beside the final one and rename it, so that the final one is always complete."""
    beside = file.with_name(f"{file.name}.{os.getpid()}")
    with beside.open("wb") as stream:
        stream.write(image)
        if now:
            stream.flush()
            os.fsync(stream.fileno())
    beside.replace(file)


def _written(folder: Path) -> contextlib.AbstractContextManager[None]:
    """A context in which failures of writing into the folder become an `ArchiveError`."""
    return writing(folder, "What is finished stays there; the same sweep goes on from it.")


def _fingerprint(definition: Scene | LFTModel, samples: Samples) -> str:
    """A text that tells one pair of source and given samples from another."""
    digest = hashlib.sha256()
    if isinstance(definition, LFTModel):
        digest.update(items_of_model(definition)[DIGEST].tobytes())
    else:
        digest.update(scene_to_toml(definition).encode())
    if isinstance(samples, GivenSamples):
        digest.update(np.ascontiguousarray(samples.points).tobytes())
    return digest.hexdigest()
