"""Rules of the source that no tool checks: public docstrings, tolerances in one place, small files."""

import ast
import inspect
import re
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

import mbdlft

ROOT = Path(__file__).parents[2]
SOURCES = sorted((ROOT / "mbdlft").rglob("*.py"))
MOST = 15  # imports of the package in functions
ROOMS = (*mbdlft._NAMESPACES, *mbdlft._ELSEWHERE)
PUBLIC = sorted(name for room in ROOMS for name in import_module(f"mbdlft.{room}").__all__)


def test_public_names_are_there() -> None:
    expected = {"Parameter", "Angle", "Scene", "RigidBody", "PointMass", "Revolute", "Prismatic", "Fixed"}
    expected |= {"to_lft", "load_scene", "save", "load", "LFT", "LFTModel", "matrices_at", "solve_trim"}
    assert expected <= set(PUBLIC)


def test_a_name_has_one_room() -> None:
    assert len(PUBLIC) == len(set(PUBLIC))
    assert set(mbdlft._FIRST) <= set(PUBLIC)
    for name, room in mbdlft._FIRST.items():
        assert name in import_module(f"mbdlft.{room}").__all__
        assert getattr(mbdlft, name) is getattr(import_module(f"mbdlft.{room}"), name)


def test_no_folder_has_the_name_of_a_public_function() -> None:
    """An import on first use would return now one, now the other, if it did not say which one."""
    folders = {path.name for path in (ROOT / "mbdlft").iterdir()}
    both = folders & {*PUBLIC, *(f"{name}.py" for name in PUBLIC)}
    assert both == {"lft"}
    assert mbdlft._MODULES["lft"] == "mbdlft.lft"
    assert mbdlft.__getattr__("lft") is import_module("mbdlft.lft") is not mbdlft.system.lft


def test_names_of_most_scripts_are_shown_and_given_by_a_star() -> None:
    assert set(dir(mbdlft)) == {*mbdlft._FIRST, *mbdlft._NAMESPACES}
    assert 40 <= len(mbdlft._FIRST) <= 50
    given: dict[str, object] = {}
    exec("from mbdlft import *", given)
    assert {*dir(mbdlft)} <= set(given)
    assert given["feedback"] is mbdlft.system.feedback


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("to_lfx", "mbdlft.to_lft"),
        ("feedbck", "mbdlft.system.feedback"),
        ("Struct", "mbdlft.multibody.Strut"),
        ("qqqq", r"dir\(mbdlft\) lists"),
    ],
)
def test_a_wrong_name_finds_its_namespace(name: str, meant: str) -> None:
    with pytest.raises(AttributeError, match=f"has no attribute '{name}'.*{meant}"):
        getattr(mbdlft, name)


def test_records_show_their_fields() -> None:
    point = mbdlft.PointMass(name="tip", mass=1.0)
    assert {"name", "ports", "mass"} <= set(dir(point))
    assert not [name for name in dir(point) if name.startswith(("_", "model_", "copy"))]


def test_few_loose_files() -> None:
    assert len([path for path in (ROOT / "mbdlft").glob("*.py")]) <= 6


def test_python_page_lists_them_all_each_in_its_namespace() -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    tables = {
        section.partition("\n")[0]: "\n".join(re.findall(r"^\|.*", section, re.MULTILINE))
        for section in page.split("\n## ")
    }
    assert set(tables) - {"# The Python package", "Models and examples"} == {
        "mbdlft",
        "Other names",
        *(f"mbdlft.{room}" for room in mbdlft._NAMESPACES),
    }
    for room in ROOMS:
        where = f"mbdlft.{room}" if room in mbdlft._NAMESPACES else "Other names"
        for name in import_module(f"mbdlft.{room}").__all__:
            table = tables["mbdlft" if name in mbdlft._FIRST else where]
            assert re.search(rf"`(?:mbdlft\.\w+\.)?{name}\b", table), (room, name)


@pytest.mark.parametrize("name", PUBLIC)
def test_public_names_are_documented(name: str) -> None:
    item = getattr(mbdlft, name)
    assert inspect.getdoc(item), f"{name} has no docstring"
    if inspect.isfunction(item):
        text = inspect.getdoc(item) or ""
        parameters = [p for p in inspect.signature(item).parameters if p not in ("scene", "equations")]
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


def test_files_have_at_most_500_lines() -> None:
    large = {
        path.relative_to(ROOT / "mbdlft").as_posix()
        for path in SOURCES
        if len(path.read_text(encoding="utf-8").splitlines()) > 500
    }
    assert not large


def test_functions_have_at_most_60_lines() -> None:
    long = {
        f"{path.relative_to(ROOT / 'mbdlft').as_posix()}:{node.name}"
        for path in SOURCES
        for node in functions(path.read_text(encoding="utf-8"))
        if _lines(node) > 60
    }
    assert not long


@cache
def functions(text: str) -> list[ast.FunctionDef | ast.AsyncFunctionDef]:
    """All functions of a text, those inside of others too."""
    found = statements(ast.parse(text))
    return [node for node in found if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """A node and all statements inside of it; `ast.walk` visits their expressions, ten times as many."""
    yield node
    for inner in ast.iter_child_nodes(node):
        if isinstance(inner, ast.stmt | ast.excepthandler | ast.match_case):
            yield from statements(inner)


def imports_inside(text: str) -> int:
    """Imports of the package inside functions of a text."""
    lines = {
        node.lineno
        for function in functions(text)
        for node in statements(function)
        if (isinstance(node, ast.ImportFrom) and ((node.module or "").startswith("mbdlft") or node.level))
        or (isinstance(node, ast.Import) and any(name.name.startswith("mbdlft") for name in node.names))
    }
    return len(lines)


def test_few_functions_import_the_package() -> None:
    assert (
        imports_inside("def f():\n    def g():\n        from mbdlft.a import b\n    import mbdlft.c\n")
        == 2
    )
    assert imports_inside("import mbdlft\ndef f():\n    import numpy\n") == 0
    counts = {str(path): imports_inside(path.read_text(encoding="utf-8")) for path in SOURCES}
    assert sum(counts.values()) <= MOST, {path: count for path, count in counts.items() if count}


def test_lines_of_a_function_count_all_but_its_docstring() -> None:
    text = '@one\n@two\ndef f(\n    a,\n):\n    """Is a\n    docstring."""\n    return a\n'
    (function,) = ast.parse(text).body
    assert _lines(function) == 6


def _lines(function: ast.AST) -> int:
    """Lines of a function with its decorators, without its docstring."""
    assert isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
    assert function.end_lineno is not None
    first = min(node.lineno for node in (function, *function.decorator_list))
    lines = function.end_lineno - first + 1
    if ast.get_docstring(function) is not None:
        docstring = function.body[0]
        assert docstring.end_lineno is not None
        lines -= docstring.end_lineno - docstring.lineno + 1
    return lines


def test_no_leftovers() -> None:
    for path in SOURCES:
        assert not re.search(r"\b(TODO|FIXME|XXX)\b", path.read_text(encoding="utf-8")), path


def test_only_tests_import_tests() -> None:
    """Whoever installs the benchmarks has no tests; what both need stands in benchmarks/cases/."""
    pattern = re.compile(r"^\s*(from|import) tests\b", re.MULTILINE)
    assert pattern.search((ROOT / "tests" / "laws" / "test_couplings.py").read_text(encoding="utf-8"))
    for folder in ("benchmarks", "bodies", "mbdlft", "scenarios"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            assert not pattern.search(path.read_text(encoding="utf-8")), path
