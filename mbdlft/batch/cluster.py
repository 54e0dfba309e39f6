"""Shards of a sweep on a Dask cluster: its workers compute them, and this process writes them.

So each shard is written once. If a worker is lost, the scheduler gives its tasks to another one.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from importlib import import_module
from typing import Any

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.batch.compiled import fastest
from mbdlft.batch.extra import Extra
from mbdlft.batch.rows import Source, source_of
from mbdlft.batch.staging import Work, points_at, rows_at
from mbdlft.multibody.scene import Scene, scene_from_toml, scene_to_toml
from mbdlft.system.model import LFTModel

_AHEAD = 2  # shards that are submitted at a time, for each thread of the cluster


def cluster_shards(
    client: Any, given: Scene | LFTModel, work: Work, shards: Sequence[int]
) -> Iterator[tuple[int, Array]]:
    """Yield each shard with its rows (n, width) as soon as the cluster has finished it.

    Raises
    ------
    AnalysisError
        Dask is not installed, or workers died again and again over one shard.
    """
    try:
        distributed: Any = import_module("distributed")  # an optional extra
    except ImportError:
        raise AnalysisError("sweep: a cluster needs Dask: pip install 'mbdlft[cluster]'.") from None
    sent = given if isinstance(given, LFTModel) else scene_to_toml(given)
    # the source is the result of a task: data that is scattered is lost with the workers that hold it
    source = client.submit(_received, sent, pure=False)
    waiting, number = iter(shards), {}

    def submit(shard: int) -> Any:
        # not pure, so that the cluster does not take the result of an earlier sweep
        points = points_at(work, shard)
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


def _received(given: str | LFTModel) -> str | LFTModel:
    """The argument itself, as the result of a task."""
    return given


def shard_rows(given: str | LFTModel, count: int, extra: Extra, points: Array) -> Array:
    """Rows (n, width) at the samples `points` (n, n_p) of a shard, for a scene in TOML or a model.

    `count` samples are in all shards.
    """
    return rows_at(*_source(given, count), extra, points)


@lru_cache(maxsize=4)
def _source(given: str | LFTModel, count: int) -> tuple[Source, int]:
    """The source of rows, and its chunk; a worker makes it once for all of its shards."""
    known = source_of(given if isinstance(given, LFTModel) else scene_from_toml(given))
    return fastest(known, count), known.chunk
