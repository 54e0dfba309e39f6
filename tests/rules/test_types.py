"""Types of the package are right, and what the README and the docs show is as strict."""

import inspect
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import mbdlft
from mbdlft.base.description import Description
from tests.rules.test_docs import PAGES, ROOT, blocks

# functions without annotations, so that they are short; a field that may be None, for one that has it
NOT_TYPED = ("archive-format", "scenes")
# no garbage is looked for: a fifth of the time
MYPY = """
import gc
gc.disable()
gc.enable = int
from mypy.__main__ import console_entry
console_entry()
"""


def test_package_and_examples_are_typed(tmp_path: Path) -> None:
    """By one run of mypy, beside other tests: without its cache it takes some 25 s of a processor."""
    pages = [page for page in PAGES if page.stem not in NOT_TYPED]
    count = 0
    for page in pages:
        for k, block in enumerate(blocks(page, "python")):
            name = re.sub(r"\W", "_", page.stem)
            (tmp_path / f"{name}_{k}.py").write_text(block, encoding="utf-8")
            count += 1
    assert count > 20
    command = [sys.executable, "-c", MYPY, "mbdlft", *map(str, sorted(tmp_path.glob("*.py")))]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_names_that_are_also_modules_are_functions_for_type_checkers() -> None:
    """A star brings the modules of a package, too, in place of names that came before."""
    root = ROOT / "mbdlft"
    modules = {path.stem for path in root.glob("*/*.py")} | {path.name for path in root.glob("*/*/")}
    modules |= {path.name for path in root.glob("*/")}
    public = {
        name: namespace
        for namespace in (*mbdlft._NAMESPACES, *mbdlft._ELSEWHERE)
        for name in import_module(f"mbdlft.{namespace}").__all__
    }
    text = (root / "__init__.py").read_text(encoding="utf-8")
    after = text.rpartition("import *")[2]
    said = set(re.findall(r"^    from mbdlft\.(\w+) import (\w+) as \2$", after, re.MULTILINE))
    assert said == {(public[name], name) for name in modules & set(public)}


def test_lists_are_taken_where_records_have_tuples() -> None:
    """Type checkers other than mypy, whose plugin takes anything, go by what fields are declared as."""
    import_module("mbdlft.multibody.scene")
    pending, seen = [Description], list[type]()
    while pending:
        kind = pending.pop()
        pending += kind.__subclasses__()
        seen.append(kind)
        if kind.__module__.startswith("mbdlft."):
            fields = re.findall(
                r"^    (\w+): (?!ClassVar).*\btuple\[", inspect.getsource(kind), re.MULTILINE
            )
            assert not fields, f"{kind.__name__}: {fields}: use Many, Vector or Direction"
    assert len(seen) > 30
