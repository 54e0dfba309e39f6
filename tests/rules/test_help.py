"""What `help()` shows of public names: signatures that a reader would write, and a sentence."""

import inspect
import pydoc
import re
from importlib import import_module
from typing import Any

import pytest
from pydantic import BaseModel

import mbdlft
from mbdlft.base.display import readable

NAMESPACES = (*mbdlft._NAMESPACES, *mbdlft._ELSEWHERE)
# what checks values, addresses, what numpy and pydantic make of a type
_MACHINERY = re.compile(r"0x|<function|lambda|Annotated|Strict|InstanceOf|FieldInfo|_array_like|SX\(")
_LONGEST = 820


def public() -> dict[str, Any]:
    """Every public class and function, by its place."""
    found = {}
    for namespace in NAMESPACES:
        module = import_module(f"mbdlft.{namespace}")
        found |= {f"{namespace}.{name}": getattr(module, name) for name in module.__all__}
    errors = BaseException  # these have the signature of Python's own
    return {
        place: item
        for place, item in found.items()
        if callable(item) and not (inspect.isclass(item) and issubclass(item, errors))
    }


@pytest.mark.parametrize("namespace", NAMESPACES)
def test_signatures_are_what_a_reader_would_write(namespace: str) -> None:
    for place, item in public().items():
        if place.partition(".")[0] == namespace:
            text = str(inspect.signature(item))
            assert not _MACHINERY.search(text), f"{place}{text}"
            assert len(text) < _LONGEST, f"{place}{text}"


def test_the_first_line_is_a_sentence() -> None:
    for place, item in public().items():
        first = (inspect.getdoc(item) or "").partition("\n\n")[0]
        assert re.match(r"[A-Z`|0-9]|.*[=/]", first), f"{place}: {first!r}"  # or a formula
        assert first.endswith((".", ":")) or "=" in first, f"{place}: {first!r}"
        assert not first.startswith(f"{item.__name__}("), f"{place} has no docstring of its own"


def test_methods_say_what_they_do() -> None:
    for place, item in public().items():
        if not inspect.isclass(item) or issubclass(item, BaseModel):
            continue
        for name, method in vars(item).items():
            own = inspect.isfunction(method) or isinstance(method, property | classmethod)
            if own and not name.startswith("_"):
                assert inspect.getdoc(getattr(item, name)), f"{place}.{name}"


def test_help_is_found_where_a_name_is_public() -> None:
    """Also of a name that is imported when it is first used."""
    for item in (mbdlft.to_lft, mbdlft.Revolute, mbdlft.Parameter, mbdlft.LFTModel, mbdlft):
        assert len(pydoc.render_doc(item, renderer=pydoc.plaintext)) > 500
    text = pydoc.render_doc(mbdlft.Prismatic, renderer=pydoc.plaintext)
    assert "axis: (float, float, float), position: float | str = 0.0" in text


def test_types_in_words() -> None:
    assert readable(dict[str, tuple[float | str, float | str]]) == (
        "dict of str to (float | str, float | str)"
    )
    assert readable(tuple[int | None, ...]) == "list of (int | None)"
    assert readable(mbdlft.Scene.model_fields["bodies"].annotation) == "list of Body"
