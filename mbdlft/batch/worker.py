"""A worker process: it reads numbers of shards from its input, one a line, and computes them.

It answers each line when the shard is in its file. It ends when its input ends, so that no process stays
when the sweep is killed.
"""

import contextlib
import json
import sys
from pathlib import Path

from mbdlft.base.errors import MbdlftError
from mbdlft.batch.compiled import fastest
from mbdlft.batch.staging import opened, places, points_at, rows_at, write_shard


def main(folder: Path) -> None:
    """Compute shards until the input ends."""
    try:
        work = opened(folder)
        source, at = fastest(work.source, work.count), places(folder, work)
        for line in sys.stdin:
            shard = int(line)
            rows = rows_at(source, work.source.chunk, work.extra, points_at(work, shard))
            write_shard(folder, work, at, shard, rows)
            _answer({"shard": shard})
    except MbdlftError as error:
        _answer({"error": type(error).__name__, "message": str(error)})
    except FileNotFoundError:
        pass  # another process has finished the sweep or thrown it away


def _answer(answer: dict[str, object]) -> None:
    """Write an answer as one line of JSON."""
    with contextlib.suppress(BrokenPipeError):  # the sweep was killed, but the shard is in its file
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
