"""How far a command is, on stderr of a terminal: its stage, what is done of a budget, the time left."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.status import Status

from mbdlft.base.spent import heard

_OFTEN = 0.1  # s between two looks
_KNOWN = 1.0  # s after which the time that is left is guessed


class Progress:
    """A line that says how far a command is.

    Parameters
    ----------
    name : of what is worked on
    status : Status
        Where it is shown.
    """

    def __init__(self, name: str, status: Status) -> None:
        self.name, self._status = name, status
        self._stage, self._rest = "", ""
        self._begun = self._shown = 0.0
        self._first = self._done = self._most = 0.0

    def stage(self, stage: str) -> None:
        """Another stage begins."""
        self._stage, self._rest, self._most = stage, "", 0.0
        self._show()

    def bounds(self, low: float, high: float) -> None:
        """What is sought is between two numbers."""
        self._stage = f"{low:.4g} to {high:.4g}"
        self._show()

    def worked(self, done: float, most: float) -> None:
        """So many units of a budget are done; it may not be used up."""
        if self._counted(done, most):
            share = f"{100.0 * self._done / most:.0f} % of the work that is allowed"
            left = self._left()
            self._rest = f", {share}" + (f", at most {left}" if left else "")
            self._show()

    def counted(self, done: int, count: int) -> None:
        """So many of so many pieces are done."""
        if self._counted(done, count):
            left = self._left()
            self._rest = f", {done} of {count}" + (f", {left}" if left else "")
            self._show()

    def _counted(self, done: float, most: float) -> bool:
        """Whether it is time to show a count; one of another budget begins anew."""
        now = time.monotonic()
        if most != self._most or done < self._first:
            self._begun, self._first, self._done, self._most = now, done, done, most
        self._done = max(self._done, done)
        if now < self._shown + _OFTEN and done < most:
            return False
        self._shown = now
        return True

    def _left(self) -> str:
        seconds = time.monotonic() - self._begun
        if seconds < _KNOWN:
            return ""
        return time_left(seconds, self._done - self._first, self._most - self._first)

    def _show(self) -> None:
        stage = f": {self._stage}" if self._stage else ""
        self._status.update(escape(f"{self.name}{stage}{self._rest}"))


@contextmanager
def progress_of(name: str) -> Iterator[Progress]:
    """A line on stderr that says how far the work inside is; nothing where stderr is no terminal."""
    with Console(stderr=True).status(escape(name)) as status:
        progress = Progress(name, status)
        with heard(progress.worked):
            yield progress


def time_left(seconds: float, done: float, count: float) -> str:
    """Words on the time that the rest takes, if it goes on as in the first `seconds`; none before that.

    `done` of `count` pieces took these seconds.
    """
    if not 0.0 < done < count:
        return ""
    left = round(seconds * (count - done) / done)
    if left < 60:
        return f"about {left} s left"
    minutes, hours = left // 60, left // 3600
    return (
        f"about {minutes} min left" if left < 3600 else f"about {hours} h {minutes % 60} min left"
    )
