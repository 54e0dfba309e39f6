"""Walks through a page: its blocks in their order, as a reader types them, and what they print."""

import contextlib
import io
import re
import shlex
from collections.abc import Callable
from pathlib import Path

_BLOCK = re.compile(r"^```(python|sh|toml|text)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_FILE = re.compile(r"# ([\w-]+\.(?:toml|py|mo))\n")
Run = Callable[..., tuple[int, str, str]]


def walk(page: Path, run: Run) -> int:
    """Go through a page in the working folder; how many blocks there were.

    Files (TOML) with their name in the first line are written, Python is run in one namespace, commands
    by `run`; the lines of a text are those that the block before it has printed, in their order.
    """
    names: dict[str, object] = {"__name__": "example"}
    printed, blocks = "", _BLOCK.findall(page.read_text(encoding="utf-8"))
    for language, text in blocks:
        if language == "toml":
            name = _FILE.match(text)
            if name:  # others show a part of a file
                Path(name.group(1)).write_text(text, encoding="utf-8")
        elif language == "python":
            stream = io.StringIO()
            with contextlib.redirect_stdout(stream):
                exec(compile(text, str(page), "exec"), names)
            printed = stream.getvalue()
        elif language == "sh":
            printed = "".join(_command(line, run) for line in text.splitlines())
        else:
            _compare(page, text, printed)
    return len(blocks)


def _command(line: str, run: Run) -> str:
    """What a command prints."""
    name, *arguments = shlex.split(line)
    assert name == "mbdlft", line
    code, out, err = run(*arguments)
    assert (code, err) == (0, ""), (line, err)
    return out


def _compare(page: Path, text: str, printed: str) -> None:
    """Each line of the text stands in what was printed, behind the one before."""
    rest = re.sub(r"\s+", " ", printed)
    for line in text.splitlines():
        wanted = re.sub(r"\s+", " ", line.strip())
        found = rest.find(wanted)
        assert found >= 0, f"{page.name}: {wanted!r} is not in {rest!r}"
        rest = rest[found + len(wanted) :]
