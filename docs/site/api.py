"""Pages of the API: one for each namespace, from the lists of its public names."""

import inspect
from importlib import import_module
from pathlib import Path
from pprint import pformat

from pydantic import BaseModel

import mbdlft


def namespaces() -> dict[str, list[str]]:
    """Modules with the public names that they list."""
    modules = [f"mbdlft.{name}" for name in mbdlft._NAMESPACES]
    modules += ["mbdlft.multibody.equilibrium.fit"]
    modules += [f"mbdlft.{name}" for name in mbdlft._ELSEWHERE]
    return {module: sorted(import_module(module).__all__) for module in modules}


def write_api(folder: Path) -> None:
    """Write a page for each namespace, and the list of them."""
    folder.mkdir(parents=True)
    found = namespaces()
    for module, names in found.items():
        (folder / f"{_short(module)}.md").write_text(page(module, names), encoding="utf-8")
    lines = ["# All names", "", "The text of each page is that of the docstrings, as `help()` shows",
             "it. A [table](../python.md) has all names on one page.", "", "```{toctree}"]  # fmt: skip
    lines += [_short(module) for module in found] + ["```", ""]
    (folder / "index.md").write_text("\n".join(lines), encoding="utf-8")


def _short(module: str) -> str:
    return module.rpartition(".")[2]


def page(module: str, names: list[str]) -> str:
    """The page of one namespace."""
    first = (inspect.getdoc(import_module(module)) or "").partition("\n\n")[0]
    lines = [f"# mbdlft.{_short(module)}", "", first, ""]
    for name in names:
        item = getattr(import_module(module), name)
        lines += [f"## {name}", ""]
        if not callable(item):  # numbers and names, which say what they are
            lines += ["```python", f"{name} = {pformat(item)}", "```", ""]
            continue
        directive = "autoclass" if inspect.isclass(item) else "autofunction"
        lines += ["```{eval-rst}", f".. {directive}:: {module}.{name}"]
        if directive == "autoclass" and not issubclass(item, BaseModel):
            lines.append("   :members:")  # descriptions have fields, which are in the signature
        lines += ["```", ""]
    return "\n".join(lines)
