"""Notebooks: run by IPython in this process, without a kernel beside it, and written as pages.

A kernel (nbclient with ipykernel) would be fifteen more packages; IPython comes with the viewer's.
"""

import base64
import contextlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from IPython.core.displayhook import CapturingDisplayHook
from IPython.core.interactiveshell import InteractiveShell
from IPython.utils.capture import capture_output
from traitlets.config import Config


class Cell(NamedTuple):
    """A cell: `markdown` or `code`, its text, what it has printed, and shown, by MIME type."""

    kind: str
    source: str
    printed: str = ""
    shown: tuple[Mapping[str, Any], ...] = ()


def cells_of(path: Path) -> list[Cell]:
    """The cells of a notebook file as they are stored."""
    stored = json.loads(path.read_text(encoding="utf-8"))
    return [Cell(cell["cell_type"], "".join(cell["source"])) for cell in stored["cells"]]


def run_notebook(path: Path, folder: Path) -> list[Cell]:
    """Run a notebook in a folder; its cells with what they show.

    Raises
    ------
    RuntimeError
        A cell ends with an error.
    """
    stored, done = cells_of(path), []
    with contextlib.chdir(folder), _shell(folder) as shell:
        for number, cell in enumerate(stored):
            if cell.kind != "code":
                done.append(cell)
                continue
            with capture_output() as captured:
                shell.display_trap.hook = CapturingDisplayHook(shell=shell, outputs=(outputs := []))
                result = shell.run_cell(cell.source)
            error = result.error_before_exec or result.error_in_exec
            if error is not None:
                raise RuntimeError(f"{path.name}, cell {number}: {error}") from error
            shown = tuple(output["data"] for output in outputs)
            done.append(Cell(cell.kind, cell.source, captured.stdout, shown))
    return done


@contextlib.contextmanager
def _shell(folder: Path) -> Iterator[InteractiveShell]:
    """A shell that leaves nothing behind: no history, and no files but in a folder."""
    settings = Config({"HistoryManager": {"enabled": False}})
    try:
        yield InteractiveShell.instance(config=settings, ipython_dir=str(folder / ".ipython"))
    finally:
        InteractiveShell.clear_instance()


def page_of(cells: list[Cell], name: str) -> str:
    """A page in Markdown of cells that have been run."""
    parts = []
    for cell in cells:
        if cell.kind != "code":
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        if cell.printed:
            parts.append(f"```text\n{cell.printed.rstrip()}\n```")
        parts += [_output(data) for data in cell.shown]
    parts.append(f"The file: {{download}}`{name} <{name}>`.")
    return "\n\n".join(parts) + "\n"


def _output(data: Mapping[str, Any]) -> str:
    """What a cell shows: a picture, or HTML, or else text."""
    if "image/png" in data:
        stored = data["image/png"]
        text = stored if isinstance(stored, str) else base64.b64encode(stored).decode("ascii")
        shown = f'<img src="data:image/png;base64,{text}" style="max-width:100%">'
    elif "text/html" in data:
        shown = str(data["text/html"])
    else:
        return f"```text\n{data['text/plain']}\n```"
    return f"```{{raw}} html\n{shown}\n```"


def write_notebooks(notebooks: Path, folder: Path) -> None:
    """Run all notebooks of a folder and write their pages, each beside its file."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(notebooks.glob("*.ipynb")):
        cells = run_notebook(path, folder)
        (folder / f"{path.stem}.md").write_text(page_of(cells, path.name), encoding="utf-8")
        (folder / path.name).write_bytes(path.read_bytes())
