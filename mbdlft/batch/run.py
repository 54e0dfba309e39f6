"""A sweep: its shards computed by this process, by workers, or by a Dask cluster, and its report."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.archive.archive import check_file, check_name, locked
from mbdlft.archive.sweep import FUNCTION_FAILED, NO_EQUILIBRIUM, SINGULAR, SOLVED, Places, finish_sweep
from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.base.worker import Pool, processes_of
from mbdlft.batch import staging
from mbdlft.batch.native import fastest
from mbdlft.batch.rows import Extra, Function, Source, asked_of, source_of
from mbdlft.batch.samples import GridSamples, RandomSamples, samples_of
from mbdlft.multibody.scene import Scene, scene_from_toml, scene_to_toml
from mbdlft.system.model import LFTModel

_BUSY = "computes this sweep now. Wait until it ends, or give this one another name."


@dataclass(frozen=True, slots=True)
class SweepReport:
    """The result of a sweep, in numbers of samples.

    Attributes
    ----------
    name : str
        Name of the sweep in the archive.
    count, solved : int
        All samples, and those that were solved.
    not_converged, no_equilibrium : int
        Samples that were not solved; their rows are NaN.
    failed : int
        Samples that were solved, but at which the function of the user raised an error, or gave a number
        that is not finite; these numbers are NaN.
    resumed : int
        Samples that an earlier run had computed.
    seconds : float
    """

    name: str
    count: int
    solved: int
    not_converged: int
    no_equilibrium: int
    failed: int
    resumed: int
    seconds: float


@arguments_checked
def sweep(
    source: Scene | LFTModel,
    samples: GridSamples | RandomSamples | Mapping[str, ArrayLike],
    path: str | Path,
    *,
    name: str | None = None,
    workers: int | None = None,
    restart: bool = False,
    progress: Callable[[int, int], None] | None = None,
    client: Any = None,
    poles: bool = False,
    function: str | Function | None = None,
    float32: bool = False,
) -> SweepReport:
    """Trim and linearize at many samples: write A, B, C, D at each p_k into /sweeps/<name> of an archive.

    The nonlinear equations of a scene are trimmed and linearized again at each sample; a model is
    evaluated there. A sample that fails is no error: its row is NaN and has a status. Finished shards are
    kept in a folder beside the archive until the archive is written. So after a kill, the same call
    continues from there, and it gives the same numbers. The archive is complete or unchanged.

    Parameters
    ----------
    source : Scene or LFTModel
    samples : GridSamples, RandomSamples, or mapping of names to numbers or arrays (N,)
        Physical values in the units of the parameters, inside their ranges; a parameter that is not named
        is nominal.
    path : file, an archive; made if it does not exist
    name : str, optional
        Name in the archive, by default that of the source; a sweep of this name is replaced.
    workers : int, optional
        Number of processes; by default one for each core. With 1 this process does all of the work.
    restart : bool
        Whether to throw away the shards of an unfinished sweep of this name.
    progress : function, optional
        Called with the number of finished samples and the number of all samples.
    client : distributed.Client, optional
        A Dask cluster that computes instead of processes of this machine (extra `cluster`).
    poles : bool
        Whether to compute the eigenvalues of A, too.
    function : function, or str ``module:name``, optional
        It gets a `SweepPart`, solved samples together, and gives real arrays (N,) by name, each number
        made of its own sample. Where it raises an error or a number is not finite, the status is 3.
        Processes import it, so it is in a file of its own.
    float32 : bool
        Whether to store all numbers but samples and residuals in single precision: half of the space, and
        seven digits.

    Raises
    ------
    AnalysisError
        The samples are wrong, another sweep of this name is not finished, or workers die. Or the function
        cannot be imported, raises errors at all of some samples, or does not give what it must.
    TrimError
        The unknown efforts of the scene are redundant, or its elastic bodies carry a load.
    ArchiveError
        The archive, or the folder beside it, cannot be written; another process computes a sweep of this
        name now; or a number is too large for single precision.
    """
    begun = time.perf_counter()
    processes = processes_of(workers, "sweep")
    file, key = Path(path), source.name if name is None else name
    check_name(file, "sweep", key)
    check_file(file)
    parameters = sorted(source.parameters, key=lambda parameter: parameter.name)
    all_samples = samples_of(parameters, samples)
    extra = Extra(poles=poles, single=float32)
    if function is not None:
        definition = source_of(source)
        extra = asked_of(definition, all_samples, poles=poles, function=function, single=float32)
    folder = file.parent / f".{file.name}.{key}.sweep"
    with locked(folder, patience=0.0, busy=_BUSY):
        work = staging.prepare(folder, source, all_samples, extra, restart=restart)
        todo = staging.missing(folder, work)
        resumed = work.count - sum(map(work.rows_of, todo))
        done = resumed
        if progress is not None:
            progress(done, work.count)
        for shard in _computed(folder, source, work, todo, processes, client):
            done += work.rows_of(shard)
            if progress is not None:
                progress(done, work.count)
        counts = _put_together(file, key, folder, source, work)
    return SweepReport(
        name=key,
        count=work.count,
        solved=int(counts[SOLVED]),
        not_converged=int(counts[SINGULAR]),
        no_equilibrium=int(counts[NO_EQUILIBRIUM]),
        failed=int(counts[FUNCTION_FAILED]),
        resumed=resumed,
        seconds=time.perf_counter() - begun,
    )


def _put_together(
    file: Path, key: str, folder: Path, source: Scene | LFTModel, work: staging.Work
) -> NDArray[np.intp]:
    """Make the archive of the rows in a folder, which is then gone; how many rows have each status."""
    counts = np.bincount(staging.places(folder, work).statuses(staging.rows_file(folder)), minlength=4)
    is_model = isinstance(source, LFTModel)
    finish_sweep(
        file,
        key,
        work.layout,
        staging.rows_file(folder),
        staging.blocks_of(folder, work),
        work.block_rows,
        model=source.name if is_model else "",
        scene="" if isinstance(source, LFTModel) else scene_to_toml(source),
    )
    staging.clear(folder)
    return counts


def _computed(
    folder: Path,
    source: Scene | LFTModel,
    work: staging.Work,
    todo: list[int],
    processes: int,
    client: Any,
) -> Iterator[int]:
    """Compute shards and put them into the folder; yield each when it is there."""
    at = staging.places(folder, work)
    if client is not None:
        for shard, rows in cluster_shards(client, source, work, todo):
            staging.write_shard(folder, work, at, shard, rows)
            yield shard
        return
    if min(processes, len(todo)) > 1:
        kept = "What is finished is kept: the same sweep goes on from it, with fewer workers if you like."
        what = "sweep", "shard", kept
        with Pool(f"{__name__}:compute_shard", min(processes, len(todo)), what) as pool:
            for shard, _ in pool.run({shard: (folder, shard) for shard in todo}):
                yield shard
        return
    fast = fastest(work.source, work.count) if todo else work.source
    for shard in todo:  # starting a process would take longer than computing most shards
        rows = staging.rows_at(fast, work.source.chunk, work.extra, staging.points_at(work, shard))
        staging.write_shard(folder, work, at, shard, rows)
        yield shard


_AHEAD = 2  # shards that are submitted at a time, for each thread of the cluster


def cluster_shards(
    client: Any, definition: Scene | LFTModel, work: staging.Work, shards: Sequence[int]
) -> Iterator[tuple[int, Array]]:
    """Yield each shard with its rows (n, width) as soon as the cluster has finished it."""
    try:
        distributed: Any = import_module("distributed")  # an optional extra
    except ImportError:
        raise AnalysisError("sweep: a cluster needs Dask: pip install 'mbdlft[cluster]'.") from None
    sent = definition if isinstance(definition, LFTModel) else scene_to_toml(definition)
    # the source is the result of a task: data that is scattered is lost with the workers that hold it
    source = client.submit(_received, sent, pure=False)
    waiting, number = iter(shards), {}

    def submit(shard: int) -> Any:
        # not pure, so that the cluster does not take the result of an earlier sweep
        points = staging.points_at(work, shard)
        future = client.submit(shard_rows, source, work.count, work.extra, points, pure=False)
        number[future] = shard
        return future

    ahead = _AHEAD * max(1, sum(client.nthreads().values()))
    first = [submit(shard) for _, shard in zip(range(ahead), waiting, strict=False)]
    running = distributed.as_completed(first)
    for future in running:
        try:
            rows = future.result()
        except distributed.KilledWorker as error:
            raise AnalysisError(
                f"sweep: workers of the cluster died over shard {number[future]}: {error}. What is "
                "finished is kept: the same sweep goes on from it."
            ) from None
        yield number.pop(future), rows
        for shard in waiting:
            running.add(submit(shard))
            break


def _received(definition: str | LFTModel) -> str | LFTModel:
    """The argument itself, as the result of a task."""
    return definition


def shard_rows(definition: str | LFTModel, count: int, extra: Extra, points: Array) -> Array:
    """Rows (n, width) at the samples `points` (n, n_p) of a shard, for a scene in TOML or a model.

    `count` samples are in all shards.
    """
    return staging.rows_at(*_source(definition, count), extra, points)


@lru_cache(maxsize=4)
def _source(definition: str | LFTModel, count: int) -> tuple[Source, int]:
    """The source of rows, and its chunk; a worker makes it once for all of its shards."""
    known = source_of(definition if isinstance(definition, LFTModel) else scene_from_toml(definition))
    return fastest(known, count), known.chunk


def compute_shard(folder: Path, shard: int) -> None:
    """What a worker does: it computes the rows of a shard and puts them into the folder."""
    try:
        work, source, at = _opened(folder)
        rows = staging.rows_at(source, work.source.chunk, work.extra, staging.points_at(work, shard))
        staging.write_shard(folder, work, at, shard, rows)
    except FileNotFoundError:
        raise AnalysisError(
            f"sweep: {folder} is gone: another process has finished the sweep or thrown it away."
        ) from None


@lru_cache(maxsize=1)
def _opened(folder: Path) -> tuple[staging.Work, Source, Places]:
    """A sweep as another process reads it from its folder, what computes its rows, and their places."""
    work = staging.opened(folder)
    return work, fastest(work.source, work.count), staging.places(folder, work)
