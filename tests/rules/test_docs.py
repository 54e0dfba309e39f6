"""What the README and the docs show can be copied, pasted and run."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from docs.site.notebooks import cells_of, page_of, run_notebook
from mbdlft.cli.commands import loaded
from tests.close import CLOSED_FORM, target
from tests.rules.walk import walk
from tests.scenarios.commands import Call

ROOT = Path(__file__).parents[2]
# pages that are walked through from top to bottom; blocks of the others stand for themselves
WALKS = [ROOT / "docs" / "tutorial.md", *sorted((ROOT / "docs").glob("task-*.md"))]
PAGES = [ROOT / "README.md", *sorted({*(ROOT / "docs").glob("*.md")} - {*WALKS})]
# of these the default run knows that their types are right and their commands are accepted
SLOW = ("analysis", "bodies", "command-line", "dae", "examples", "export", "figures",
        "from-simscape-sdtlib", "gain-scheduling", "matrices", "poles-and-responses", "report", "robust",
        "task-modelica", "task-nastran", "task-tune", "tutorial", "uncertain", "worst_case")  # fmt: skip


def quick_first(pages: list[Path]) -> list[Any]:
    """Parameters of a test; slow pages run with the long tests."""
    marks = {True: [pytest.mark.long], False: []}
    return [pytest.param(page, marks=marks[page.stem in SLOW], id=page.name) for page in pages]


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "scenarios").symlink_to(ROOT / "scenarios")
    (tmp_path / "bodies").symlink_to(ROOT / "bodies")
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("workplace")
@pytest.mark.parametrize("page", quick_first(PAGES[1:]))  # the first is the README, below
def test_python_examples_run(page: Path) -> None:
    for block in blocks(page, "python"):
        exec(compile(block, str(page), "exec"), {"__name__": "example"})


def test_numbers_in_the_readme_are_true(workplace: Path) -> None:
    names: dict[str, object] = {}
    (block,) = blocks(ROOT / "README.md", "python")
    exec(block, names)
    model = names["model"]
    assert isinstance(model, mbdlft.LFTModel)
    assert model.order == 16
    assert model.certificate.minimal
    assert model.certificate.lower_bound == (1, 2, 1, 2, 2, 4, 4)
    assert model.certificate.max_relative_error < CLOSED_FORM
    assert (workplace / "out" / "arm.h5").exists()


@pytest.mark.usefixtures("workplace")
@pytest.mark.parametrize("page", quick_first(WALKS))
def test_pages_can_be_followed_to_their_end(page: Path, call: Call) -> None:
    assert walk(page, call) >= 3


def test_a_walk_stops_where_a_page_is_wrong(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    for text, reason in (
        ("```python\nprint(1.5)\n```\n\n```text\n1.6\n```\n", "is not in"),
        ("```python\nraise ValueError('here')\n```\n", "here"),
        ("```sh\nmbdlft nonsense\n```\n", "no such command"),
    ):
        page.write_text(text, encoding="utf-8")
        with pytest.raises((AssertionError, ValueError), match=reason):
            walk(page, lambda *_: (2, "", "no such command"))


WITH_COMMANDS = [page for page in PAGES if blocks(page, "sh")]


def test_pages_have_commands() -> None:
    assert ROOT / "README.md" in WITH_COMMANDS
    assert len(WITH_COMMANDS) >= 4


def test_commands_of_pages_are_accepted() -> None:
    """Their names and options, and how many arguments they take."""
    pages = [*WITH_COMMANDS, *WALKS]
    lines = [line for page in pages for block in blocks(page, "sh") for line in block.splitlines()]
    for line in lines:
        _, command, *arguments = shlex.split(line)
        assert loaded(command).make_context(command, arguments)
    assert len(lines) > 40
    with pytest.raises(Exception, match="No such option"):
        loaded("show").make_context("show", ["out/arm.h5", "--nonsense"])


@pytest.mark.parametrize("page", quick_first(WITH_COMMANDS))
def test_shell_examples_run(page: Path, workplace: Path, call: Call) -> None:
    """`show` of the README as a user types it; the others in this process."""
    if page.name != "README.md":  # pages go on from its first archive
        arm = mbdlft.to_lft(mbdlft.load_scene(ROOT / "scenarios" / "two_link_arm.toml"))
        mbdlft.save(workplace / "out" / "arm.h5", arm)
    for line in (line for block in blocks(page, "sh") for line in block.splitlines()):
        name, *arguments = line.split()
        assert name == "mbdlft", line
        if page.name == "README.md" and arguments[0] == "show":
            script = Path(sys.executable).parent / name
            command = [str(script), *arguments]
            result = subprocess.run(command, cwd=workplace, capture_output=True, text=True, check=False)
            code, err = result.returncode, result.stderr
        else:
            code, _, err = call(*arguments)
        assert (code, err) == (0, ""), line


def test_scene_example_builds() -> None:
    (block,) = blocks(ROOT / "README.md", "toml")
    model = mbdlft.to_lft(mbdlft.scene_from_toml(block), search=0.0)
    assert model.certificate.max_relative_error < CLOSED_FORM
    assert [signal.name for signal in model.inputs] == ["tilt.torque", "slide.force"]


def test_matrix_example_is_realized() -> None:
    (block,) = blocks(ROOT / "docs" / "matrices.md", "toml")
    problem = mbdlft.matrix_from_toml(block)
    model = mbdlft.realize(problem, search=0.0)
    assert model.certificate.max_relative_error < CLOSED_FORM
    target(model.at(k=2.0, m=1.25).A, [[0, 1], [-9 - 2 / 1.25, -0.12]], CLOSED_FORM)


def test_reader_of_the_docs_reproduces_samples(workplace: Path) -> None:
    """Twenty lines with h5py only, against the library, for all substitutions and maps."""
    block = blocks(ROOT / "docs" / "archive-format.md", "python")[0]
    assert "mbdlft" not in block
    assert len([line for line in block.splitlines() if line.strip()]) <= 28
    names: dict[str, object] = {}
    exec(block, names)
    text = (ROOT / "scenarios" / "two_link_arm.toml").read_text(encoding="utf-8")
    text = text.replace("nominal = 90.0,", 'nominal = 80.0, substitution = "quarter-angle",')
    model = mbdlft.to_lft(mbdlft.scene_from_toml(text), search=0.0)
    mbdlft.save(workplace / "arm.h5", model)
    samples = mbdlft.random(model.parameters, 20, seed=3)
    for k in range(20):
        values = {name: float(column[k]) for name, column in samples.items()}
        found = names["state_matrix"](workplace / "arm.h5", "two_link_arm", values)  # type: ignore[operator]
        target(found, mbdlft.matrices_at(model, values).A, CLOSED_FORM)
    nominal = names["state_matrix"](workplace / "arm.h5", "two_link_arm", {})  # type: ignore[operator]
    target(nominal, model.A, CLOSED_FORM)
    assert not np.allclose(nominal, found)


# Notebooks run from their first cell to their last one, and are stored without results --------------

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) >= 2


@pytest.mark.parametrize("path", quick_first(NOTEBOOKS))
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
