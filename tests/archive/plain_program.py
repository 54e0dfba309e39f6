"""The reader of the program that docs/archive-format.md shows: h5py and numpy only, nothing of mbdlft."""

import re
from collections.abc import Callable
from typing import Any

from tests.archive.plain_digest import PAGE

NAMES: dict[str, Any] = {}
exec(re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[2], NAMES)
matrices: Callable[..., Any] = NAMES["matrices"]
