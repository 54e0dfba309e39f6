"""What the README and the docs show is accepted by type checkers, as strictly as the package is."""

import re
import subprocess
import sys
from pathlib import Path

from tests.rules.test_docs import PAGES, ROOT, blocks

# functions without annotations, so that they are short; a field that may be None, for one that has it
NOT_TYPED = ("archive-format", "scenes")


def test_examples_are_typed(tmp_path: Path) -> None:
    pages = [page for page in PAGES if page.stem not in NOT_TYPED]
    count = 0
    for page in pages:
        for k, block in enumerate(blocks(page, "python")):
            name = re.sub(r"\W", "_", page.stem)
            (tmp_path / f"{name}_{k}.py").write_text(block, encoding="utf-8")
            count += 1
    assert count > 20
    command = [sys.executable, "-m", "mypy", "--config-file", "pyproject.toml", "--strict"]
    files = [str(path) for path in sorted(tmp_path.glob("*.py"))]
    done = subprocess.run([*command, *files], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
