"""State matrices of a system at samples of its parameters, in coordinates that are similar in size."""

from collections.abc import Mapping, Sequence

from mbdlft.base.array import ArrayLike
from mbdlft.base.errors import AnalysisError, unknown_name
from mbdlft.base.signal import Signal
from mbdlft.response.resolvent import balancing
from mbdlft.system.model import System
from mbdlft.system.points import StateMatrices, matrices_at

Names = str | Sequence[str] | None  # of channels; None: all


def samples_at(system: System, values: Mapping[str, ArrayLike] | None = None) -> StateMatrices:
    """A (N, nx, nx), B (N, nx, nu), C (N, ny, nx), D (N, ny, nu) at physical values by name.

    The states are scaled by powers of 2, which are those of the nominal A for every sample: so a sample
    has the same digits alone and among others. N is 1 for numbers.

    Raises
    ------
    StructureError, WellPosednessError
        As `matrices_at`.
    """
    found = [
        matrix if matrix.ndim == 3 else matrix[None] for matrix in matrices_at(system, values or {})
    ]
    scale = balancing(system.A)
    A, B, C, D = found
    return StateMatrices(A * (scale / scale[:, None]), B / scale[:, None], C * scale, D)


def chosen(model: str, kind: str, names: Names, signals: Sequence[Signal], what: str) -> list[int]:
    """Numbers of the signals of these names; of all of them without names.

    Raises
    ------
    AnalysisError
        None is chosen, so that there is no `what`; or a name is unknown.
    """
    known = [signal.name for signal in signals]
    asked = [names] if isinstance(names, str) else known if names is None else list(names)
    if not asked:
        raise AnalysisError(
            f"model {model!r}: without {kind}s there are no {what}. Choose some in [linearize]."
        )
    for name in asked:
        if name not in known:
            raise AnalysisError(f"model {model!r}: " + unknown_name(kind, str(name), known))
    return [known.index(name) for name in asked]


def transfers_at(
    system: System,
    values: Mapping[str, ArrayLike] | None,
    outputs: Names,
    inputs: Names,
    what: str,
) -> StateMatrices:
    """As `samples_at`, with some of the outputs and inputs; `what` is computed of them."""
    rows = chosen(system.name, "output", outputs, system.outputs, what)
    columns = chosen(system.name, "input", inputs, system.inputs, what)
    A, B, C, D = samples_at(system, values)
    return StateMatrices(A, B[:, :, columns], C[:, rows], D[:, rows][:, :, columns])
