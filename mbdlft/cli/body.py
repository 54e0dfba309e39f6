"""The command `body`: it prints the table of a catalogue body, for a scene file."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from mbdlft.cli.options import AsJson
from mbdlft.cli.tables import print_json


def body(
    body_file: Annotated[Path, typer.Argument(help="Catalogue body, a TOML file.")],
    name: Annotated[str | None, typer.Option(help="Name of the body in the scene.")] = None,
    method: Annotated[str | None, typer.Option(help="Component modes.")] = None,
    modes: Annotated[int | None, typer.Option(help="Number of modes.")] = None,
    frequency: Annotated[float | None, typer.Option(help="Highest frequency, rad/s.")] = None,
    effective_mass: Annotated[float | None, typer.Option(help="Fraction of the mass.")] = None,
    damping: Annotated[float | None, typer.Option(help="Damping ratio of all modes.")] = None,
    as_json: AsJson = False,
) -> None:
    """Print the table of a catalogue body, to be pasted into a scene file."""
    from mbdlft.elastic.catalogue import body_table, load_body, reduced_body
    from mbdlft.elastic.report import effective_masses
    from mbdlft.multibody.scene.toml import body_to_toml

    given = {"method": method, "modes": modes, "frequency": frequency}
    given |= {"effective_mass": effective_mass, "damping": damping}
    choices = {key: value for key, value in given.items() if value is not None}
    table = body_table(body_file)
    notes = [f"{body_file.name}: {table['description']}", f"Source: {table['source']}"]
    catalogue_body = load_body(body_file, name, **choices)
    if "data" in table:
        notes.append(effective_masses(reduced_body(body_file, **choices)).table())
    if as_json:
        print_json({"toml": body_to_toml(catalogue_body), "notes": notes})
        return
    comment = "\n".join(notes)
    sys.stdout.write("".join(f"# {line}\n".replace(" \n", "\n") for line in comment.splitlines()))
    sys.stdout.write(f"\n{body_to_toml(catalogue_body)}")
