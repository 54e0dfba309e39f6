"""Build the documentation: `python -m docs.site [FOLDER]`, by default into out/site.

The pages of docs/ are copied into a folder beside, those of the API and of the notebooks are written
there, and Sphinx makes the site of them. A warning of Sphinx is an error.
"""

import argparse
import shutil
import sys
from pathlib import Path

from sphinx.cmd.build import build_main

from docs.site.api import write_api
from docs.site.notebooks import write_notebooks

DOCS = Path(__file__).parents[1]
_COPIED = (".md", ".png", ".svg", ".webp", ".jsonl")


def prepare(folder: Path) -> None:
    """Everything that Sphinx reads, in a new folder."""
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    for path in sorted(DOCS.rglob("*")):
        if path.suffix in _COPIED and path.is_relative_to(DOCS / "site") is False:
            target = folder / path.relative_to(DOCS)
            target.parent.mkdir(exist_ok=True)
            shutil.copy(path, target)
    write_api(folder / "api")
    write_notebooks(DOCS / "notebooks", folder / "notebooks")


def build(target: Path) -> int:
    """Build the site into a folder; the exit code of Sphinx, 0 without any warning."""
    source = target.with_name(target.name + "_source")
    prepare(source)
    settings = Path(__file__).parent
    return build_main(
        ["-W", "--keep-going", "-q", "-E", "-c", str(settings), "-b", "html", str(source), str(target)]
    )


def main() -> None:
    """Build, and say where."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("out/site"))
    target = parser.parse_args().folder
    code = build(target)
    if code == 0:
        sys.stdout.write(f"{target / 'index.html'}\n")
    sys.exit(code)


if __name__ == "__main__":
    main()
