"""The site of the documentation: links lead somewhere, every page and public name is in it, it builds."""

import inspect
import re
import subprocess
import sys
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import pytest

import mbdlft
from tests.browser import browser

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]
_LINK = re.compile(r"\]\(([^)\s]+)\)")
_NAME = re.compile(r"\bmbdlft\.([a-z_]+(?:\.[A-Za-z_]\w*)*)")


def anchors(page: Path) -> set[str]:
    """What a link to a section of a page may be: titles in lower case, with hyphens."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def broken(page: Path) -> list[str]:
    """Links of a page that lead nowhere in the repository; links of the web are left out."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    wrong = []
    for link in _LINK.findall(text):
        if link.startswith(("http://", "https://", "mailto:")):
            continue
        name, _, section = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        outside = page.parent == DOCS and not target.is_relative_to(DOCS)  # the site has no such page
        if outside or not target.exists() or (section and section not in anchors(target)):
            wrong.append(link)
    return wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    assert not broken(page)


def test_titles_are_not_deeper_than_their_place() -> None:
    """A section of the second depth is inside one of the first: Sphinx refuses others."""
    for page in PAGES:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        depths = [len(marks) for marks in re.findall(r"^(#+) ", text, re.MULTILINE)]
        assert all(b <= a + 1 for a, b in pairwise(depths)), page.name


def test_broken_links_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# One\n[a](#one) [b](#two) [c](other.md) [d](https://x.y) ![e](e.png)\n")
    assert broken(page) == ["#two", "other.md", "e.png"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_names_of_the_package_in_the_text_exist(page: Path) -> None:
    """`mbdlft.a.b` in a page is a module, or what can be found in one."""
    for path in _NAME.findall(page.read_text(encoding="utf-8")):
        first, *rest = path.split(".")
        if f"{first}.{'.'.join(rest)}".rstrip(".") in ("h5", "cli.commands.app"):
            continue
        item = getattr(mbdlft, first, None) or import_module(f"mbdlft.{first}")
        for name in rest:
            item = getattr(item, name, None) or import_module(f"{item.__name__}.{name}")


def test_functions_and_classes_that_pages_name_are_public() -> None:
    """Names with capitals or underscores, behind which a parenthesis stands, in the pages for readers."""
    from docs.site.api import namespaces

    public = {name for names in namespaces().values() for name in names}
    public |= set(dir(mbdlft.LFTModel))
    said = re.compile(r"`(?:\w+\.)*([A-Za-z]\w*)\([^`]*`")
    pages = [DOCS / name for name in ("tutorial.md", "trials.md", "conventions.md", "python.md")]
    found = [
        name for page in (*pages, *DOCS.glob("task-*.md")) for name in said.findall(page.read_text())
    ]
    for line in (DOCS / "coming-from.md").read_text(encoding="utf-8").splitlines():
        here = line.split("|")[2] if line.count("|") == 3 else ""
        found += said.findall(here)
        found += re.findall(r"`((?:[a-z]+_[a-z_]+|[A-Z]\w+))`", here)
    keys = {"atan", "sin", "cos", "sqrt", "dae", "array", "actuator_inertia", "EXTSEOUT"}
    assert len(found) > 60
    assert set(found) - keys <= public, set(found) - keys - public


def test_every_page_is_in_the_table_of_contents() -> None:
    listed = re.findall(r"^[\w/-]+$", (DOCS / "index.md").read_text(encoding="utf-8"), re.MULTILINE)
    pages = [path.relative_to(DOCS).with_suffix("").as_posix() for path in DOCS.glob("*.md")]
    notebooks = [f"notebooks/{path.stem}" for path in (DOCS / "notebooks").glob("*.ipynb")]
    assert sorted(listed) == sorted([*{*pages} - {"index"}, *notebooks, "api/index"])


def test_every_public_function_has_an_example() -> None:
    """It stands in a block of Python of a page, or in a notebook; these are run by test_docs."""
    from docs.site.api import namespaces

    blocks = [
        block
        for page in PAGES
        for block in re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    ]
    blocks += [path.read_text("utf-8") for path in (DOCS / "notebooks").glob("*.ipynb")]
    shown = set(re.findall(r"\w+", "\n".join(blocks)))
    functions = {
        item.__name__  # a former name leads to the function of another one
        for module, names in namespaces().items()
        for item in (getattr(import_module(module), name) for name in names)
        if inspect.isfunction(item)
    }
    assert len(functions) > 100
    assert functions <= shown, sorted(functions - shown)


WORDS = {  # what people search for, and the page whose title has it
    "uncertain": "uncertain.md",
    "robust": "robust.md",
    "gain scheduling": "gain-scheduling.md",
    "flexible spacecraft": "flexible-spacecraft.md",
    "launcher": "launchers.md",
    "Simscape": "from-simscape-sdtlib.md",
    "SDTlib": "from-simscape-sdtlib.md",
}


def test_words_of_users_lead_to_a_page() -> None:
    """A title with the word comes first in a search; the page has an example."""
    for word, name in WORDS.items():
        text = (DOCS / name).read_text(encoding="utf-8")
        title = text.partition("\n")[0]
        assert word.lower() in title.lower(), name
        assert "```python" in text or "```sh" in text


def test_numbers_of_the_page_for_one_minute_are_those_of_their_pages() -> None:
    text = (DOCS / "one-minute.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.*?) \| (.*?) \| .*?\((.+?)\) \|$", text, re.MULTILINE)
    assert len(rows) >= 8
    for _, said, name in rows:
        page = (DOCS / name).read_text(encoding="utf-8")
        for number in re.findall(r"\d+\.\d+(?:e-?\d+)?|\d{2,}(?! [0-9])", said):
            assert number in page, (name, number)
    assert len(text.split()) < 250  # a minute


def test_pages_of_the_api_have_every_public_name() -> None:
    from docs.site.api import namespaces, page

    found = namespaces()
    assert {f"mbdlft.{name}" for name in mbdlft._NAMESPACES} <= set(found)
    for module, names in found.items():
        text = page(module, names)
        assert set(re.findall(r"^## (\w+)$", text, re.MULTILINE)) == set(import_module(module).__all__)


def test_pictures_of_the_gallery_are_few_and_those_that_are_shown() -> None:
    shown = set(re.findall(r"\(gallery/([^)]+)\)", (DOCS / "gallery.md").read_text(encoding="utf-8")))
    files = {path.name: path.stat().st_size for path in (DOCS / "gallery").iterdir()}
    assert shown == set(files)
    assert sum(files.values()) < 600_000
    files = (ROOT / "scenarios").rglob("*.toml")
    scenes = {path.stem for path in files if path.parent.name != "tasks"}
    models = {path.stem for path in (ROOT / "scenarios" / "modelica").glob("*.mo")}
    assert scenes | models <= {Path(name).stem for name in shown}


def test_orders_of_the_gallery_are_those_of_the_table() -> None:
    from docs.site.gallery import orders

    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    entries = {part.partition("\n")[0]: " ".join(part.split()) for part in text.split("\n### ")}
    found = orders()
    assert len(found) >= 25
    for name, (order, bound) in found.items():
        said = (
            f"Order {order}, proved minimal." if order == bound else f"Order {order}; at least {bound},"
        )
        assert said in entries[name], f"{name}: run python -m docs.site.gallery"


def test_pictures_of_mechanisms_are_those_of_the_scenes() -> None:
    """The file of a changed scene or of a changed way to draw is written by the script again."""
    from docs.site.gallery import film_of_bicycle, picture_of

    words = re.compile(r"<text[^>]*>([^<]*)</text>|<(polyline|circle|polygon)")
    for path in sorted((DOCS / "gallery").glob("*.svg")):
        drawn = film_of_bicycle() if path.stem == "bicycle_film" else picture_of(path.stem)
        assert words.findall(drawn) == words.findall(path.read_text("utf-8")), path.name


@pytest.mark.long
def test_site_builds_without_warnings_and_asks_the_network_for_nothing(tmp_path: Path) -> None:
    pytest.importorskip("sphinx", reason="the extra 'docs' is not installed")
    site = tmp_path / "site"
    command = [sys.executable, "-m", "docs.site", str(site)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 50
    for path in (site / "api").glob("*.html"):  # what Sphinx made of colons, and of named tuples
        assert not re.search(r">Type<span|Alias for field", path.read_text(encoding="utf-8")), path.name
    assert '<td class="short"' in (site / "hard-cases.html").read_text(encoding="utf-8")
    with browser() as load:
        for path in pages:
            loaded = load(path)
            assert not loaded.complaints, (path.name, loaded.complaints)
            loaded.page.close()
        tutorial = load(site / "tutorial.html")
        drawn = tutorial.run(
            "[...document.querySelectorAll('math')].map(m => m.getBoundingClientRect().height)"
        )
        assert len(drawn) >= 5
        assert min(drawn) > 5
