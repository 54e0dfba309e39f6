"""The structure and the equilibrium of a model as its table asks for them."""

from mbdlft.base.errors import StructureError
from mbdlft.dae.description import Dae
from mbdlft.dae.structure import Structure, reduce_index
from mbdlft.dae.trim import DaeTrim, trim
from mbdlft.modelica.table import ModelicaTable
from mbdlft.modelica.translate import ModelicaReport


def operating_point(
    dae: Dae, report: ModelicaReport | None = None, table: ModelicaTable | None = None
) -> DaeTrim:
    """The equilibrium of a model, with the states and the values that its table asks for.

    Parameters
    ----------
    dae, report
        As `load_modelica` gives them.
    table : ModelicaTable, optional

    Raises
    ------
    StructureError, TrimError, NotRationalError
        As `mbdlft.dae.reduce_index` and `mbdlft.dae.trim`.
    """
    table = table or ModelicaTable()
    structure = structure_of(dae, report, table)
    return trim(structure, table.at, table.free, table.moving, table.fit)


def structure_of(
    dae: Dae, report: ModelicaReport | None = None, table: ModelicaTable | None = None
) -> Structure:
    """The structure of a model, with the states that its table asks for or that it prefers itself.

    Parameters
    ----------
    dae, report, table
        As in `operating_point`.
    """
    if table is not None and table.states:
        return reduce_index(dae, states=table.states)
    if report is not None and report.states:
        try:
            return reduce_index(dae, states=report.states)
        except StructureError:  # a preference is no condition
            pass
    return reduce_index(dae)
