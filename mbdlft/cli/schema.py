"""The command `schema`: the JSON schema of scene files, for editors."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from mbdlft.base.errors import SceneError
from mbdlft.cli.options import AsJson
from mbdlft.cli.tables import print_files


def schema(
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="File to write; else it is printed.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write the JSON schema of scene files: editors complete and check keys and kinds with it."""
    from mbdlft.multibody.scene import scene_schema

    text = json.dumps(scene_schema(), indent=2, ensure_ascii=False) + "\n"
    if output is None:
        sys.stdout.write(text)  # which is JSON
        return
    try:
        output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise SceneError(f"{output}: cannot be written: {error.strerror or error}.") from None
    if as_json:
        print_files(("schema", output), as_json=True)
