"""Programs of scenes that were compiled before: the scene is assembled only when its definition is asked.

Making a program takes longer than loading its code. It is kept in the folder of native code, under the
text of the scene, the versions, and the size and date of each file of this package: the same text gives
the same program, whose values were compared with the definition when it was made.
"""

import io
import json
import sys
import zipfile
from dataclasses import asdict, dataclass, field
from functools import cached_property, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.archive.program import coded, decoded
from mbdlft.archive.sweep import Layout
from mbdlft.base.array import Array
from mbdlft.base.errors import ArchiveError
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Signal
from mbdlft.batch.rows import EquationSource, source_of
from mbdlft.lft.program.native import key_of, user_cache
from mbdlft.multibody.scene import Scene, scene_to_toml
from mbdlft.problem.equations import Equations
from mbdlft.problem.linearization import StraightLine

_FORM = "1"  # of what is kept: another one is not read
_NOT_READ = (ArchiveError, ValueError, KeyError, TypeError, OSError, zipfile.BadZipFile, EOFError)


@dataclass(eq=False)
class SceneSource:
    """The source of rows of a scene that is assembled when it is asked for rows."""

    scene: Scene
    layout: Layout  # that of its `definition`, as is the chunk
    chunk: int
    parameters: tuple[Parameter, ...] = field(init=False)

    def __post_init__(self) -> None:
        self.parameters = tuple(sorted(self.scene.parameters, key=lambda p: p.name))

    @cached_property
    def definition(self) -> EquationSource:
        """The equations."""
        source = source_of(self.scene)
        assert isinstance(source, EquationSource)
        return source

    @property
    def equations(self) -> Equations:
        """Those of the scene."""
        return self.definition.equations

    def rows(self, points: Array) -> tuple[Array, Array, Array, Array]:
        """The rows at points (N, n_p), as `Source.rows` describes them."""
        return self.definition.rows(points)


def remembered(scene: Scene) -> tuple[SceneSource, StraightLine] | None:
    """The program of a scene, if it was compiled before; what is not as it was written is not used."""
    cache = user_cache()
    image = cache.get(_key(scene), "program") if cache else None
    if image is None:
        return None
    try:
        with np.load(io.BytesIO(image), allow_pickle=False) as stored:
            items = {name: stored[name] for name in stored.files}
        head = json.loads(items.pop("head").tobytes())
        signals: Any = {k: tuple(Signal(*signal) for signal in some) for k, some in head["layout"]}
        layout = Layout(**signals)
        program, row = decoded(items, len(layout.parameters), head["size"])
    except _NOT_READ:
        return None
    line = StraightLine(program, row, tuple(head["shape"]), head["trims"])
    return SceneSource(scene, layout, head["chunk"]), line


def remember(scene: Scene, source: EquationSource, line: StraightLine) -> None:
    """Keep the program of a scene, if there is a folder for it."""
    cache = user_cache()
    if cache is None:
        return
    names = ("parameters", "states", "inputs", "outputs", "trim")
    layout = [(name, [list(asdict(s).values()) for s in getattr(source.layout, name)]) for name in names]
    head = {
        "layout": layout,
        "shape": list(line.shape),
        "trims": line.trims,
        "chunk": source.chunk,
        "size": len(line.row),
    }
    image = io.BytesIO()
    text = np.frombuffer(json.dumps(head).encode(), dtype=np.uint8)
    items: dict[str, Any] = coded(line.program, line.row)
    np.savez(image, head=text, **items)
    cache.put(_key(scene), image.getvalue(), "program")


def _key(scene: Scene) -> str:
    """What a program depends on: the text of the scene, and all that makes a program of it."""
    kinds = {
        type(item) for items in (scene.bodies, scene.joints, scene.loads, scene.sensors) for item in items
    }
    outside = sorted(_stamp(Path(file)) for file in map(_file, kinds) if file)
    made_of = (_FORM, scene_to_toml(scene), _package(), *outside)
    return key_of(*made_of, sys.version, *(version(name) for name in ("casadi", "numpy")))


def _file(kind: type) -> str | None:
    """The file of a kind that is not of this package."""
    module = kind.__module__
    if module.partition(".")[0] == __name__.partition(".")[0]:
        return None
    return getattr(sys.modules.get(module), "__file__", None)


@lru_cache(maxsize=1)
def _package() -> str:
    """Size and date of each file of this package."""
    folder = Path(__file__).parents[1]
    return "\n".join(sorted(map(_stamp, folder.rglob("*.py"))))


def _stamp(file: Path) -> str:
    try:
        status = file.stat()
    except OSError:
        return f"{file} is gone"
    return f"{file} {status.st_size} {status.st_mtime_ns}"
