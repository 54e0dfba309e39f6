"""The straight-line program of a model: that of the equations of its scene, to be stored with it."""

from dataclasses import replace

from mbdlft.base.errors import StructureError
from mbdlft.batch.compiled import equations_of, of_equations
from mbdlft.batch.rows import deltas_at
from mbdlft.batch.samples import RandomSamples, points_of
from mbdlft.lft.evaluation import LONGEST, ModelProgram, agrees, compact, values_by
from mbdlft.lft.program.tape import Program
from mbdlft.system.model import LFTModel

_PROBES = 32  # samples at which it is compared with the LFT


def with_program(model: LFTModel) -> LFTModel:
    """The model with a straight-line program of its values: the equations of its scene, eliminated.

    Values of an LFT of many repetitions take dense matrices; the program takes sums and products only,
    and `save` stores it, so that whoever loads the model, without CasADi too, evaluates as fast.
    `computed_by` says what `matrices_at` takes.

    Parameters
    ----------
    model : LFTModel
        Made from a scene, as `to_lft` does, and exact.

    Returns
    -------
    LFTModel

    Raises
    ------
    StructureError
        It is no such model, or the equations have no program of at most 200 000 instructions, or other
        values than the model.
    """
    if not isinstance(model, LFTModel):
        raise StructureError(
            f"with_program: expected an LFTModel, got {type(model).__name__}. to_lft(scene) makes one."
        )
    what = f"model {model.name!r}, with_program"
    source = equations_of(model)
    if source is None:
        raise StructureError(
            f"{what}: it is not the model of a scene as to_lft makes it, but truncated, fitted, "
            "connected, of other ranges, or of something else. Its LFT is evaluated."
        )
    line = of_equations(source)
    if line is None:
        raise StructureError(
            f"{what}: the equations have no program of at most {LONGEST} instructions; the LFT "
            "is evaluated."
        )
    size = model.lft.M22.size + (model.trim.lft.M22.size if model.trim.lft is not None else 0)
    entries = tuple(entry for entry in line.program.entries if entry[0][1] < size)
    program = Program(line.program.inputs, line.program.instructions, entries, line.program.pivots)
    known = ModelProgram(compact(program), line.row[:size], model.lft, model.trim.lft)
    points = points_of(RandomSamples(_PROBES, 0), model.parameters, 0, _PROBES)
    deltas = deltas_at(model, points)
    for lft in (model.lft, model.trim.lft):
        if lft is not None and not agrees(lft, deltas, *values_by(known, lft, points)):
            raise StructureError(
                f"{what}: the equations of its scene have other values than the model; please report it."
            )
    return replace(model, program=known)
