"""The pictures of docs/figures.md, drawn by the commands of that page: `python -m docs.site.figures`."""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from docs.site.gallery import DOCS, ROOT

_WIDE = 900  # pixels


def write_figures() -> None:
    """Run the commands in an empty folder, and keep their figures as docs/figures/NAME.webp."""
    (DOCS / "figures").mkdir(exist_ok=True)
    text = (DOCS / "figures.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "out").mkdir()
        (Path(folder) / "scenarios").symlink_to(ROOT / "scenarios")
        for line in re.findall(r"^mbdlft (.*)$", text, re.MULTILINE):
            subprocess.run([sys.executable, "-m", "mbdlft", *line.split()], cwd=folder, check=True)
        for name in re.findall(r"\(figures/(\w+)\.webp\)", text):
            with Image.open(Path(folder) / "out" / f"{name}.png") as image:
                image.thumbnail((_WIDE, _WIDE))
                image.convert("RGB").save(DOCS / "figures" / f"{name}.webp", quality=75, method=6)


if __name__ == "__main__":
    write_figures()
