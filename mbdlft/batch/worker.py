"""A process that computes shards: their numbers come by its input, one a line; it answers each.

It ends with its input, so that nothing is left behind when the sweep is killed.
"""

import contextlib
import json
import sys
from pathlib import Path

from mbdlft.base.errors import MbdlftError
from mbdlft.batch.staging import opened, points_at, rows_at, write_shard


def main(folder: Path) -> None:
    """Compute shards until the input ends."""
    try:
        work = opened(folder)
        for line in sys.stdin:
            shard = int(line)
            write_shard(folder, shard, rows_at(work.source, points_at(work, shard)))
            _answer({"shard": shard})
    except MbdlftError as error:
        _answer({"error": type(error).__name__, "message": str(error)})
    except FileNotFoundError:
        pass  # the sweep was finished or thrown away by someone else


def _answer(answer: dict[str, object]) -> None:
    with contextlib.suppress(BrokenPipeError):  # the sweep was killed; the shard is there
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
