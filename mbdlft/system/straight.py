"""Values of a model by its straight-line program, where that is shorter than its LFT."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import StructureError
from mbdlft.lft.evaluation import KNOWN, NATIVE, OWN, evaluate_known, is_native, way
from mbdlft.lft.lft import LFT
from mbdlft.lft.program.native import is_available
from mbdlft.system.digits import needs_digits
from mbdlft.system.singular import check_regular_at

if TYPE_CHECKING:
    from mbdlft.system.system import System


def value_by_program(
    model: "System", lft: LFT, values: Mapping[str, ArrayLike], points: Array
) -> Array | None:
    """Values (N, n_out, n_in) by the program that a model knows; None if another way is taken.

    Where a pivot of the program has lost digits, and there only, the LFT may be singular.

    Parameters
    ----------
    model : System
    lft : LFT
        That of the model, or of its trim.
    values : mapping of names to numbers or arrays (N,), in the units of the parameters
    points : array (N, n_p) [1]
        The deltas at these values.

    Raises
    ------
    WellPosednessError
        The LFT is singular at a point.
    """
    known = model.known_program
    if known is None or not (lft is known.lft or lft is known.trim):
        return None
    physical = np.empty(points.shape)
    for k, p in enumerate(model.parameters):
        physical[:, k] = values.get(p.name, p.nominal)

    def check(deltas: Array) -> None:
        if not model.is_proved_regular:
            check_regular_at(lft, deltas, model.parameters, f"model {model.name!r}")

    found = evaluate_known(lft, points, known, physical, check)
    # the LFT may then be evaluated with more digits than the equations have
    return None if found is None or needs_digits(lft, points, found) else found


def computed_by(model: "System", count: int) -> str:
    """How `matrices_at` computes `count` samples of a model.

    Parameters
    ----------
    model : System or LFTModel
    count : number of samples

    Returns
    -------
    str
        ``"dense matrices"``; ``"program of the LFT"``, which is made of the LFT when it is needed; or
        ``"stored program"``, which the model carries. With ``", native"`` behind it where it is compiled.
        Should samples of a program differ from dense matrices, those compute after all.

    Raises
    ------
    StructureError
        The number is not one.
    """
    if not isinstance(count, int) or count < 0:
        raise StructureError(f"computed_by: expected a number of samples, got {count!r}.")
    known = model.known_program
    found = way(model.lft, count, known)
    if found == KNOWN and known is not None:
        return found + ", native" * is_native(known, count)
    return found + ", native" * (found == OWN and count >= NATIVE and is_available())
