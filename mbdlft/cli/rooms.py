"""Modules of other rooms, each imported when it is first used: help and completion wait for none of them.

What is public is in the rooms themselves, which do the same.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbdlft.archive import archive as archive
    from mbdlft.dae import simulation as simulation
    from mbdlft.elastic import catalogue as catalogue
    from mbdlft.export import exports as exports
    from mbdlft.matrix import problem as problem
    from mbdlft.modelica import table as table
    from mbdlft.modelica import translation as translation
    from mbdlft.multibody import assembly as assembly
    from mbdlft.multibody import to_problem as to_problem
    from mbdlft.multibody.scene import toml as toml
    from mbdlft.pipeline import dae_models as dae_models
    from mbdlft.pipeline import models as models
    from mbdlft.problem import linearization as linearization
    from mbdlft.response import frequency as frequency
    from mbdlft.response import modes as modes
    from mbdlft.show.figures import figures as figures
    from mbdlft.show.report import content as content
    from mbdlft.show.report import sentences as sentences

_PLACES = """
archive.archive dae.simulation elastic.catalogue export.exports matrix.problem modelica.table
modelica.translation
multibody.assembly multibody.scene.toml multibody.to_problem pipeline.dae_models pipeline.models
problem.linearization response.frequency response.modes show.figures.figures show.report.content
show.report.sentences
"""


def __getattr__(name: str) -> Any:
    for path in _PLACES.split():
        if path.rpartition(".")[2] == name:
            return import_module(f"mbdlft.{path}")
    raise AttributeError(name)
