"""Shards on a Dask cluster: workers compute, this process writes, so each shard is there once.

A task that is lost with its worker is given to another one by the scheduler.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from importlib import import_module
from typing import Any

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.batch.rows import EquationSource, ModelSource, source_of
from mbdlft.batch.staging import Work, points_at, rows_at
from mbdlft.multibody.scene import Scene, scene_from_toml, scene_to_toml
from mbdlft.system.model import LFTModel

_AHEAD = 2  # shards for each thread of the cluster that are on their way


def cluster_shards(
    client: Any, given: Scene | LFTModel, work: Work, shards: Sequence[int]
) -> Iterator[tuple[int, Array]]:
    """Shards and their rows (n, width), as the cluster finishes them.

    Raises
    ------
    AnalysisError
        Dask is not there, or workers died again and again over one shard.
    """
    try:
        distributed: Any = import_module("distributed")  # an optional extra
    except ImportError:
        raise AnalysisError("sweep: a cluster needs Dask: pip install 'mbdlft[cluster]'.") from None
    sent = given if isinstance(given, LFTModel) else scene_to_toml(given)
    # the result of a task: scattered data would be lost with the workers that hold it
    source = client.submit(_received, sent, pure=False)
    waiting, number = iter(shards), {}

    def submit(shard: int) -> Any:
        # not pure: a task of an earlier sweep is not taken for this one
        future = client.submit(shard_rows, source, points_at(work, shard), pure=False)
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
    return given


def shard_rows(given: str | LFTModel, points: Array) -> Array:
    """Rows (n, width) at the samples of a shard, of a scene in TOML or a model."""
    return rows_at(_source(given), points)


@lru_cache(maxsize=4)
def _source(given: str | LFTModel) -> EquationSource | ModelSource:
    return source_of(given if isinstance(given, LFTModel) else scene_from_toml(given))
