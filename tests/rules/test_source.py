"""Rules of the source that no tool checks: public docstrings, tolerances in one place, small files."""

import inspect
import re
from pathlib import Path

import pytest

import mbdlft

ROOT = Path(__file__).parents[2]
SOURCES = sorted((ROOT / "mbdlft").rglob("*.py"))
PUBLIC = mbdlft.__all__


def test_public_names_are_there() -> None:
    expected = {
        "Parameter",
        "Angle",
        "Scene",
        "RigidBody",
        "PointMass",
        "Revolute",
        "Prismatic",
        "Fixed",
    }
    expected |= {
        "to_lft",
        "load_scene",
        "save",
        "load",
        "LFT",
        "LFTModel",
        "matrices_at",
        "solve_trim",
    }
    assert expected <= set(PUBLIC)


def test_python_page_lists_them_all() -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    missing = [name for name in PUBLIC if not re.search(rf"`{name}\b", page)]
    assert missing in ([], ["Certificate", "Signal"])


@pytest.mark.parametrize("name", PUBLIC)
def test_public_names_are_documented(name: str) -> None:
    item = getattr(mbdlft, name)
    assert inspect.getdoc(item), f"{name} has no docstring"
    if inspect.isfunction(item):
        text = inspect.getdoc(item) or ""
        parameters = [
            p for p in inspect.signature(item).parameters if p not in ("scene", "equations")
        ]
        missing = [p for p in parameters if not re.search(rf"\b{p}\b", text)]
        assert not missing, f"{name} does not mention {missing}"


def test_tolerances_stand_in_one_file() -> None:
    """No literal like 1e-9 in a comparison of a test; close.py has them all."""
    pattern = re.compile(r"(rtol|atol|abs|rel)\s*=\s*\d|approx\(")
    for path in sorted((ROOT / "tests").rglob("*.py")):
        if path.name in ("close.py", "test_source.py"):
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            assert not pattern.search(line), f"{path}:{number}: {line.strip()}"


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_stay_small(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 460


def test_no_leftovers() -> None:
    for path in SOURCES:
        assert not re.search(r"\b(TODO|FIXME|XXX)\b", path.read_text(encoding="utf-8")), path
