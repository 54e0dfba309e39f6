"""Notebooks run from their first cell to their last one, and are stored without results."""

import json
from pathlib import Path

import pytest

from docs.site.notebooks import cells_of, page_of, run_notebook

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) >= 2


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_notebooks_run(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("IPython", reason="IPython is not installed")
    cells = run_notebook(path, tmp_path)
    shown = [kind for cell in cells for data in cell.shown for kind in data]
    assert {"text/html", "text/plain"} <= set(shown)
    page = page_of(cells, path.name)
    assert page.startswith("# Notebook: ")
    assert "```{raw} html" in page
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


def test_a_notebook_that_fails_is_named(tmp_path: Path) -> None:
    pytest.importorskip("IPython", reason="IPython is not installed")
    file = tmp_path / "wrong.ipynb"
    cell = {"cell_type": "code", "source": ["assert 1 == 2, 'not equal'"]}
    file.write_text(json.dumps({"cells": [cell]}), encoding="utf-8")
    assert len(cells_of(file)) == 1
    with pytest.raises(RuntimeError, match=r"wrong\.ipynb, cell 0: not equal"):
        run_notebook(file, tmp_path)
