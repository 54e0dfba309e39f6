"""A worker process of an analysis: it reads numbers of tasks from its input, one a line.

It answers each line when the result is in its file. It ends when its input ends, so that no process stays
when the analysis is killed.
"""

import contextlib
import json
import pickle
import signal
import sys
from pathlib import Path

from mbdlft.base.errors import MbdlftError
from mbdlft.robust.crew import alone, result_file, task_file


def main(folder: Path) -> None:
    """Compute tasks until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the search, which then ends this
    for line in sys.stdin:
        number = int(line)
        file = result_file(folder, number)
        try:
            function, task = pickle.loads(task_file(folder, number).read_bytes())
            beside = file.with_suffix(".part")
            beside.write_bytes(pickle.dumps(alone(function, task)))
            beside.replace(file)
            answer: dict[str, object] = {"task": number}
        except MbdlftError as error:
            answer = {"error": type(error).__name__, "message": str(error)}
        except FileNotFoundError:  # the analysis has ended
            return
        with contextlib.suppress(BrokenPipeError):
            sys.stdout.write(json.dumps(answer) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
