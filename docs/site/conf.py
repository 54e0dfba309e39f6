"""Settings of Sphinx for the documentation: Markdown pages, pages of the API from docstrings, MathML.

`python -m docs.site` prepares the pages and calls Sphinx with this file. The pages ask the network for
nothing: mathematics is MathML, which browsers draw themselves, and the theme brings its own letters.
"""

import re
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.addnodes import pending_xref

import mbdlft

project = "mbdlft"
author = "The mbdlft authors"
project_copyright = "The mbdlft authors, MIT license"
version = release = mbdlft.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
suppress_warnings = ["myst.xref_ambiguous"]

default_role = "code"  # docstrings have names between single quotes, as Markdown does
autodoc_typehints = "none"  # the docstrings say types, shapes and units
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
napoleon_preprocess_types = False
python_maximum_signature_line_length = 200
add_module_names = False

html_theme = "furo"
html_title = "mbdlft"
html_show_sourcelink = False
html_copy_source = False
html_math_renderer = "mathml"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_theme_options = {"navigation_with_keys": False}

_SHORT, _MANY = 12, 9  # letters of a cell that is not broken; columns of a wide table
_QUOTED = re.compile(r"(``.+?``|`[^`]+`)")
_SEVERAL = re.compile(r"^\w+(, \w+)+( :.*)?$")  # one line for several attributes
_MARKUP = re.compile(r"(?<!\\)([*|])|(?<=\w)(_)(?!\w)")


def _escape(app: Any, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Stars, bars and last underscores of docstrings are letters; only quoted names are marked."""
    for number, line in enumerate(lines):
        if _SEVERAL.match(line):  # a space would end the name
            names, colon, kind = line.partition(" :")
            line = names.replace(", ", ",") + colon + kind
        parts = _QUOTED.split(line)
        parts[::2] = [_MARKUP.sub(r"\\\1\2", part) for part in parts[::2]]
        lines[number] = "".join(parts)
    if what == "property" and ":" in lines[0]:
        lines[:0] = ["..", ""]  # napoleon would take the words before the colon for a type


def _skip(app: Any, what: str, name: str, item: Any, skip: Any, options: Any) -> bool | None:
    """Fields of named tuples: the docstring of their class has them."""
    return True if str(item.__doc__).startswith("Alias for field number") else None


def _unlink(app: Any, tree: nodes.document) -> None:
    """Types of docstrings are words of English, and no names to be linked."""
    for node in list(tree.findall(pending_xref)):
        if node.get("refdomain") == "py":
            node.replace_self(node.children)


def _fit(app: Any, tree: nodes.document) -> None:
    """Numbers of tables stay on one line, and tables of many columns get small letters."""
    for entry in tree.findall(nodes.entry):
        if len(entry.astext()) <= _SHORT:
            entry["classes"].append("short")
    for table in tree.findall(nodes.tgroup):
        if table["cols"] >= _MANY:
            table.parent["classes"].append("wide")


def _visit_inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def _visit_display(translator: Any, node: nodes.math_block) -> None:
    text = "\n".join(tex2mathml(node.astext(), as_block=True).splitlines())
    translator.body.append(f'<div class="math">{text}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Sphinx calls this: the drawing of mathematics, and how docstrings are read."""
    app.add_html_math_renderer("mathml", (_visit_inline, None), (_visit_display, None))
    app.connect("doctree-read", _unlink)
    app.connect("doctree-read", _fit)
    app.connect("autodoc-process-docstring", _escape, priority=100)
    app.connect("autodoc-skip-member", _skip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
