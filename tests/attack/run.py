"""Running attacks: each seed in a process that is replaced when it hangs or dies."""

import contextlib
import json
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any

from tests.attack import SECONDS, process_of

SAY = partial(print, flush=True)
SLOW = 3.0  # times: a machine with other work is not a hang, a loop is


@dataclass(slots=True)
class Tally:
    """What came of the attacks of a class: words with their counts, and seeds that failed with why."""

    name: str
    counts: Counter[str] = field(default_factory=Counter)
    failed: dict[int, str] = field(default_factory=dict)
    slowest: tuple[float, int] = (0.0, 0)  # s, and its seed

    def line(self) -> str:
        """One line for the class."""
        what = ", ".join(f"{count} {word}" for word, count in sorted(self.counts.items()))
        total = sum(self.counts.values()) + len(self.failed)
        end = f"{len(self.failed)} FAILED" if self.failed else "0 failed"
        return (
            f"{self.name}: {total} attacks: {what or 'none'}; slowest {self.slowest[0]:.1f} s "
            f"(seed {self.slowest[1]}); {end}"
        )


def attack_of(name: str) -> Callable[[int, Path], str]:
    """The function of a class."""
    function: Callable[[int, Path], str] = import_module(f"tests.attack.{name.replace('-', '_')}").attack
    return function


def command(name: str, seed: int) -> str:
    """The command that runs one attack again, with its traceback."""
    return f"python -m tests.attack --only {name} --seed {seed} --count 1"


def once(name: str, seed: int) -> str:
    """The word for one attack, in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return attack_of(name)(seed, Path(folder))


class Attacker:
    """A process that attacks with the seeds that it is told; one that hangs or dies is replaced."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._lines: SimpleQueue[str] = SimpleQueue()

    def ask(self, name: str, seed: int) -> dict[str, Any]:
        """The "word" of one attack, or how it "failed"; and its "seconds"."""
        process, begun = self._process or self._start(), time.perf_counter()
        assert process.stdin is not None
        try:
            print(name, seed, file=process.stdin, flush=True)
            answer: dict[str, Any] = json.loads(self._lines.get(timeout=SLOW * SECONDS))
        except (Empty, OSError, ValueError) as why:
            answer = {"failed": _why(process, why), "seconds": time.perf_counter() - begun}
            self.end()
        return answer

    def _start(self) -> "subprocess.Popen[str]":
        process = self._process = process_of("tests.attack.run")
        lines = self._lines = SimpleQueue()

        def read() -> None:
            assert process.stdout is not None
            with process.stdout as answers:
                for line in answers:
                    lines.put(line)
            lines.put("")  # the end

        Thread(target=read, daemon=True).start()
        lines.get()  # it has started
        return process

    def end(self) -> None:
        """End the process, if it runs."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            if process.stdin is not None:
                with contextlib.suppress(OSError):
                    process.stdin.close()


def tally(
    attacker: Attacker, name: str, seeds: Iterable[int], until: float, said: Callable[[str], None] = SAY
) -> Tally:
    """Run the attacks of a class, until `until` (s of time.monotonic)."""
    found = Tally(name)
    for seed in seeds:
        if time.monotonic() > until:
            break
        answer = attacker.ask(name, seed)
        found.slowest = max(found.slowest, (answer["seconds"], seed))
        if "word" in answer:
            found.counts[answer["word"]] += 1
            continue
        found.failed[seed] = answer["failed"]
        said(f"FAILED {command(name, seed)}\n  {answer['failed'].strip()}")
    return found


def _why(process: "subprocess.Popen[str]", error: Exception) -> str:
    """What happened to a process that did not answer; its pipes close before it has ended."""
    if not isinstance(error, Empty):
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(SECONDS)
    return "it hangs" if process.poll() is None else f"it ended the process ({process.returncode})"


def main() -> None:
    """Attack with the class and seed of each line; answer with a line of JSON, after one when ready."""
    print("ready", flush=True)
    for line in sys.stdin:
        name, seed = line.split()
        attack_of(name)  # what it imports is no time of the attack
        begun, answer = time.perf_counter(), dict[str, Any]()
        try:
            answer["word"] = once(name, int(seed))
        except BaseException:
            answer["failed"] = traceback.format_exc()[-1500:]
        print(json.dumps({**answer, "seconds": time.perf_counter() - begun}), flush=True)


if __name__ == "__main__":
    main()
