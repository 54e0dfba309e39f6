"""The sweep: samples in shards, computed by processes or a cluster, then put into an archive."""

import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, SceneError
from mbdlft.batch.cluster import cluster_shards
from mbdlft.batch.pool import finished_shards
from mbdlft.batch.samples import GridSamples, RandomSamples, samples_of
from mbdlft.batch.staging import (
    Work,
    clear,
    missing,
    points_at,
    prepare,
    read_shards,
    rows_at,
    write_shard,
)
from mbdlft.multibody.scene import Scene, scene_to_toml
from mbdlft.store.archive import check_file, check_name
from mbdlft.store.sweep import NO_EQUILIBRIUM, SINGULAR, SOLVED, save_sweep
from mbdlft.system.model import LFTModel


@dataclass(frozen=True, slots=True)
class SweepReport:
    """What a sweep has done.

    Attributes
    ----------
    name : str
        In the archive.
    count, solved : int
        Samples, and those that were solved.
    not_converged, no_equilibrium : int
        Those that were not, whose rows are NaN.
    resumed : int
        Samples that an earlier run had computed.
    seconds : float
    """

    name: str
    count: int
    solved: int
    not_converged: int
    no_equilibrium: int
    resumed: int
    seconds: float


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
) -> SweepReport:
    """Trim and linearize at many samples: A, B, C, D at each p_k, into /sweeps/<name> of an archive.

    A scene: the nonlinear equations are trimmed and linearized again at each sample, in its inputs and
    outputs. A model: it is evaluated. Samples that fail are rows of NaN with their status, not errors.
    What is finished is kept in a folder beside the archive until the archive is written: after a kill,
    the same call goes on from there and gives the same numbers. The archive is complete or unchanged.

    Parameters
    ----------
    source : Scene or LFTModel
    samples : GridSamples, RandomSamples, or mapping of names to numbers or arrays (N,)
        Physical values in the units of the parameters, inside their ranges; the others are nominal.
    path : file, an archive; made if it does not exist
    name : str, optional
        That of the source by default; a sweep of that name is replaced.
    workers : int, optional
        Processes; by default one for each core. With 1 all is done in this one.
    restart : bool
        Throw away what an unfinished sweep of this name has left.
    progress : function of the samples that are done and their number, optional
    client : distributed.Client, optional
        A Dask cluster that computes instead of this machine's processes (extra `cluster`).

    Returns
    -------
    SweepReport

    Raises
    ------
    AnalysisError
        The samples are wrong, another sweep of this name is not finished, or workers die.
    TrimError
        The unknown efforts of the scene are redundant, or its elastic bodies carry a load.
    ArchiveError
        The archive, or the folder beside it, cannot be written.
    """
    begun = time.perf_counter()
    if not isinstance(source, Scene | LFTModel):
        raise SceneError(f"sweep: expected a Scene or an LFTModel, got {type(source).__name__}.")
    if workers is not None and workers < 1:
        raise AnalysisError(f"sweep: expected at least 1 worker, got {workers}.")
    file, key = Path(path), source.name if name is None else name
    check_name(file, "sweep", key)
    check_file(file)
    parameters = sorted(source.parameters, key=lambda parameter: parameter.name)
    found = samples_of(parameters, samples)
    folder = file.parent / f".{file.name}.{key}.sweep"
    work = prepare(folder, source, found, restart=restart)
    todo = missing(folder, work)
    resumed = work.count - sum(map(work.rows_of, todo))
    done = resumed
    if progress is not None:
        progress(done, work.count)
    for shard in _computed(folder, source, work, todo, workers, client):
        done += work.rows_of(shard)
        if progress is not None:
            progress(done, work.count)
    counts = np.zeros(3, dtype=int)

    def counted() -> Iterator[Array]:
        for rows in read_shards(folder, work):
            counts[:] += np.bincount(rows[:, -1].astype(int), minlength=3)
            yield rows

    is_model = isinstance(source, LFTModel)
    save_sweep(
        file,
        key,
        work.source.layout,
        work.count,
        counted(),
        model=source.name if is_model else "",
        scene="" if isinstance(source, LFTModel) else scene_to_toml(source),
        beside=folder,
    )
    clear(folder)
    return SweepReport(
        name=key,
        count=work.count,
        solved=int(counts[SOLVED]),
        not_converged=int(counts[SINGULAR]),
        no_equilibrium=int(counts[NO_EQUILIBRIUM]),
        resumed=resumed,
        seconds=time.perf_counter() - begun,
    )


def _computed(
    folder: Path,
    source: Scene | LFTModel,
    work: Work,
    todo: list[int],
    workers: int | None,
    client: Any,
) -> Iterator[int]:
    """Compute shards and put them into the folder; yields each when it is there."""
    if client is not None:
        for shard, rows in cluster_shards(client, source, work, todo):
            write_shard(folder, shard, rows)
            yield shard
        return
    # some systems do not tell which cores this process may use
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else ()
    processes = workers or len(allowed) or os.cpu_count() or 1
    if min(processes, len(todo)) > 1:
        yield from finished_shards(folder, todo, processes)
        return
    for shard in todo:  # to start a process for one shard would take longer than most shards
        write_shard(folder, shard, rows_at(work.source, points_at(work, shard)))
        yield shard
