"""Files of Modelica: flat text, or any model by the compiler rumoca."""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.dae.dae import Dae
from mbdlft.modelica.rumoca import model_of_tables
from mbdlft.modelica.sources import Sources
from mbdlft.modelica.table import ModelicaTable
from mbdlft.modelica.text import flat_model
from mbdlft.modelica.translation import ModelicaReport, translate
from mbdlft.modelica.tree import FlatModel
from mbdlft.multibody.scene.toml import read_file

FLAT, MODEL = ".mof", ".mo"
ROOTS = "MODELICAPATH"
_TWICE = re.compile(r"Duplicate class '([^']+)'")
_CLASS = re.compile(r"(?:^|\s)(?:model|class|block|package|record|connector|function|type)\s+(\w+)")
_SYNTAX = re.compile(r"× (.*)\n.*:(\d+):(\d+)\]")  # in what the compiler draws of a syntax error


@arguments_checked
def load_modelica(
    path: str | Path,
    table: ModelicaTable | None = None,
    *,
    model: str | None = None,
    roots: Sequence[str | Path] | None = None,
) -> tuple[Dae, ModelicaReport]:
    """The description of the model of a Modelica file.

    Parameters
    ----------
    path : file
        ``.mof``: flat Modelica text. ``.mo``: any model; it is flattened by the compiler rumoca, which
        the extra `modelica` installs.
    table : ModelicaTable, optional
        Which parameters stay, and what else is said beside the model.
    model : str, optional
        Which model of a file with several, such as ``Drives.Servo``; by default that of the table, or the
        only one.
    roots : folders of libraries, optional
        By default those of the environment variable MODELICAPATH.
    """
    table = table or ModelicaTable()
    file = Path(path)
    name = model or table.model
    text = read_file(file, str)
    if file.suffix.lower() == FLAT:
        flat = flat_model(text, file.name)
        if name is not None and name != flat.name:
            raise SceneError(f"{file.name}: the model is {flat.name!r}, and not {name!r}.")
    elif file.suffix.lower() == MODEL:
        flat = compiled_model(file, name, roots)
    else:
        raise SceneError(
            f"{file.name}: expected a Modelica file: {MODEL}, or {FLAT} for flat text as compilers "
            "write it."
        )
    return translate(flat, table)


def compiled_model(
    file: Path, model: str | None = None, roots: Sequence[str | Path] | None = None
) -> FlatModel:
    """The flat model of a Modelica file by the compiler rumoca, with the arguments of `load_modelica`."""
    try:
        import rumoca
    except ImportError:
        raise SceneError(
            f"{file.name}: a {MODEL} file needs the compiler rumoca: pip install 'mbdlft[modelica]'. "
            f"Flat text, as OpenModelica or Dymola write it, needs nothing more: a file NAME{FLAT}."
        ) from None
    named = os.environ.get(ROOTS, "").split(os.pathsep) if roots is None else map(str, roots)
    folders = [folder for folder in named if folder]
    try:
        loaded = rumoca.Session(roots=folders).load(str(file), model=model)
        tables = loaded.to_dict("flat")
    except (KeyboardInterrupt, SystemExit, TimeoutError):
        raise
    except BaseException as error:  # those of its language, too, which are no Exception
        where, reason = file.name, str(error) or f"{type(error).__name__}, without a reason"
        several = " Choose one: --model NAME, or model=NAME." if "infer model" in reason else ""
        twice = _TWICE.search(reason)
        asked, lacking = (twice[1] if twice else model), "resolve/parse failed" in reason
        defined = {f: classes for f in _files(file, folders) if (classes := _CLASS.findall(_text(f)))}
        if twice:
            names = ", ".join(f.name for f, classes in defined.items() if asked in classes)
            reason = (
                f"{asked!r} is in {names}, and it reads all files of a folder. Keep one of them there."
            )
        elif asked and lacking and not any(asked.split(".")[-1] in of for of in defined.values()):
            raise SceneError(f"{where}: {unknown_name('model', asked, defined.get(file, ()))}") from None
        syntax = next(map(_SYNTAX.search, (d.message for d in rumoca.validate(str(file)))), None)
        if syntax is not None:
            where, reason = f"{where}, line {syntax[2]}, column {syntax[3]}", f"{syntax[1]}."
        raise SceneError(f"{where}: the compiler rumoca does not take it: {reason}{several}") from None
    sources = Sources(_files(file, folders), tables["variables"])
    return model_of_tables(tables, loaded.name, sources)


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8", errors="replace")


def _files(file: Path, folders: Iterable[str]) -> Iterator[Path]:
    """The file, its neighbors and all files of libraries."""
    yield file
    yield from sorted(other for other in file.parent.glob(f"*{MODEL}") if other != file)
    for folder in folders:
        yield from sorted(Path(folder).rglob(f"*{MODEL}"))
