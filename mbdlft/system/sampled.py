"""Values of models at points of their parameters. numpy only, as reading an archive is.

A value comes from the straight-line program of a model where that is shorter than its LFT, and else from
the LFT. A point at which the LFT is singular, exactly or to working precision, is refused.

Channels of elastic bodies with their lengths as parameters have entries of many sizes. In doubles, values
of such an LFT have errors that are far above what rounding of M11, M12, M21 and M22 makes: accelerations
at low frequencies, which are differences of D and C (s I - A)^-1 B, then lose their digits. One step of
refinement in doubles tells how large these errors are, as its own errors are of their size; where they
matter, (I - M11 Delta)^-1 M12 is solved for again with residuals of twice the precision.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import StructureError, WellPosednessError, check_known
from mbdlft.base.parameter import Parameter, at_values, to_delta, to_physical
from mbdlft.base.samples import physical_points
from mbdlft.exact import rounding
from mbdlft.exact.rounding import equilibrate
from mbdlft.lft import sampling
from mbdlft.lft.lft import LFT
from mbdlft.lft.program.native import is_available
from mbdlft.lft.sparse import SparseLFT
from mbdlft.system.model import OUTSIDE, LFTModel, System

if TYPE_CHECKING:
    from control import StateSpace


class StateMatrices(NamedTuple):
    """A, B, C, D of one model, or of N with a leading axis; units as those of the signals."""

    A: Array
    B: Array
    C: Array
    D: Array


def rates_of(A: Array, B: Array) -> dict[int, int]:
    """States whose derivative is another one times a number, and that one, whose derivative is not.

    Of two that are so, as without damper and input, the first is the position if its number is a power
    of two, which samples do not change, and that of the second is not.
    """
    changes = np.any(np.concatenate([A, B], axis=2) != 0.0, axis=0)
    alone = np.flatnonzero((np.sum(changes, axis=1) == 1) & np.all(np.any(A != 0.0, axis=2), axis=0))
    rates = {p: int(np.argmax(changes[p])) for p in alone.tolist()}
    units = {p for p, v in rates.items() if np.all(A[:, p, v] == A[0, p, v]) and _is_unit(A[0, p, v])}
    of_units = {rates[p] for p in units if rates[p] not in units}
    found = {p: v for p, v in rates.items() if v not in rates or (p in units and v in of_units)}
    return {p: v for p, v in found.items() if p not in of_units}


def places_of(A: Array, B: Array, beside: Sequence[int]) -> dict[int, int]:
    """States that are places of a structure, and their rates: filters beside may look like one."""
    return {p: v for p, v in rates_of(A, B).items() if p not in beside}


def _is_unit(number: float) -> bool:
    """Whether it is a power of two, as the numbers of positions in scaled states are."""
    return bool(np.frexp(number)[0] == 0.5)


def deltas_of(model: System, values: Mapping[str, ArrayLike]) -> Array:
    """Normalized deltas (N, n_p) [1] of physical values by name; the others are nominal."""
    where, names = f"model {model.name!r}", model.parameters.names
    if not isinstance(values, Mapping):
        example = f"{{'{(names or ('m',))[0]}': 1.0}}"
        raise StructureError(f"{where}: expected values by name, such as {example}, got {values!r}.")
    check_known("parameter", map(str, values), names, where, StructureError)
    for name, value in values.items():
        if not np.issubdtype(np.asarray(value).dtype, np.number):
            raise StructureError(f"{where}: {name}: expected a number, got {value!r}.")
    advice = " Widen the range in the scene and linearize again."
    physical = physical_points(model.parameters, values, where, StructureError, advice, OUTSIDE)
    points = np.zeros(physical.shape)
    for k, parameter in enumerate(model.parameters):
        if parameter.name in values:
            points[:, k] = to_delta(parameter, physical[:, k])
    return points


@arguments_checked
def matrices_at(model: System, values: Mapping[str, ArrayLike]) -> StateMatrices:
    """State matrices at physical values by name.

    Parameters
    ----------
    model : System or LFTModel
    values : mapping of names to numbers or arrays (N,), in the units of the parameters
        The others are nominal. Blocks that are not parameters may be named, too: their deltas [1],
        matrices for full blocks, which are zero otherwise.

    Returns
    -------
    StateMatrices
        A (nx, nx) and so on for numbers; A (N, nx, nx) and so on if any value is an array.

    Raises
    ------
    WellPosednessError
        The model is singular at one of the points, exactly or to working precision.
    """
    value = value_at(model, model.lft, values)
    n = len(model.states)
    return StateMatrices(value[..., :n, :n], value[..., :n, n:], value[..., n:, :n], value[..., n:, n:])


def value_at(model: System, lft: LFT, values: Mapping[str, ArrayLike]) -> Array:
    """Value of an LFT in the deltas of a model; with a leading axis if any value is an array."""
    kinds = {block.name: block.kind for block in lft.blocks if block.kind != "real"}
    physical = values
    if kinds and isinstance(values, Mapping):
        physical = {name: value for name, value in values.items() if name not in kinds}
    points = deltas_of(model, physical)
    single = all(np.ndim(value) == 0 for value in physical.values())
    if not kinds:
        by_program = value_by_program(model, lft, values, points)
        if by_program is not None:
            return by_program
        if not model.is_proved_regular:
            check_regular_at(lft, points, model.parameters, f"model {model.name!r}")
        by_lft = with_digits(lft, points, sampling.evaluate_at(lft, points))
        return by_lft[0] if single else by_lft
    others = {name: value for name, value in values.items() if name in kinds}
    named = {p.name: points[0, k] if single else points[:, k] for k, p in enumerate(model.parameters)}
    return sampling.evaluate(lft, {**named, **others})


@arguments_checked
def trim_at(model: LFTModel, values: Mapping[str, ArrayLike]) -> Array:
    """Trimmed quantities at physical values by name, from their static LFT.

    Parameters
    ----------
    model : LFTModel
    values : mapping of names to numbers or arrays (N,), in the units of the parameters
        The others are nominal.

    Returns
    -------
    array (n_t,), or (N, n_t) if any value is an array, in the units of `model.trim.signals`
        These are what depends on parameters; there may be none.
    """
    if model.trim.lft is None:
        if model.trim.signals:
            raise StructureError(f"model {model.name!r} was stored without the LFT of its trim.")
        return np.zeros((*np.broadcast_shapes(*map(np.shape, values.values())), 0))
    return value_at(model, model.trim.lft, values)[..., 0]


def state_space_at(model: System, values: Mapping[str, Any]) -> "StateSpace":
    """`System.at`."""
    full = {block.name for block in model.lft.blocks if block.kind == "full"}
    for name, value in values.items():
        if np.ndim(value) != 2 * (name in full):
            raise StructureError(
                f"model {model.name!r}: at() takes one number for {name}; for arrays use "
                "matrices_at(model, values)."
            )
    matrices = matrices_at(model, values)
    if any(matrix.dtype.kind == "c" and matrix.imag.any() for matrix in matrices):
        raise StructureError(
            f"model {model.name!r}: its matrices are complex there, which python-control does not "
            "allow; use matrices_at(model, values)."
        )
    return in_control(model, [matrix.real for matrix in matrices], model.name)


def in_control(model: System, matrices: Sequence[Array], name: str) -> "StateSpace":
    """Real A, B, C, D with the signals of a model, whose dots python-control does not allow."""
    import control  # here because it is slow to import and reading an archive does not need it

    missing = "output" if len(model.outputs) == 1 else "state" if len(model.states) == 1 else ""
    if missing and not model.inputs:  # B or D of one row is read as a column
        raise StructureError(
            f"model {model.name!r}: python-control has no system with one {missing} and no inputs; use "
            "matrices_at(model, values)."
        )
    names = control_names(model, "states", "inputs", "outputs")
    return control.ss(*matrices, name=name.replace(".", "_"), **names)


def control_names(model: System, *kinds: str) -> dict[str, list[str]]:
    """Names of the signals of some kinds, without the dots that python-control does not allow."""
    return {kind: [signal.name.replace(".", "_") for signal in getattr(model, kind)] for kind in kinds}


def check_regular_at(lft: LFT, deltas: Array, parameters: Sequence[Parameter], what: str) -> None:
    """Raise a WellPosednessError for the first of the deltas (N, n_p) where a plain LFT is singular.

    It is so exactly, or to working precision: rounding of its entries makes it singular.
    """
    if isinstance(lft, SparseLFT):  # refused where it has no value
        return
    spread = np.repeat(deltas, [block.size for block in lft.blocks], axis=1)
    for chunk in sampling.chunks(len(deltas), lft.order):
        numbers = _conditions(np.eye(lft.order) - lft.M11 * spread[chunk, None, :])
        singular = np.flatnonzero(~(numbers <= 1.0 / float(np.finfo(float).eps)))
        if len(singular):
            at, number = deltas[chunk][singular[0]], numbers[singular[0]]
            physical = [float(to_physical(p, d)) for p, d in zip(parameters, at, strict=True)]
            how = "" if np.isinf(number) else f" to working precision (condition {number:.1e})"
            raise WellPosednessError(
                f"{what}: it is singular{how} at {at_values(parameters, physical)}, and has no value "
                "there. Choose other values, or narrow the ranges and make the model again."
            )


def _conditions(matrices: Array) -> Array:
    """Condition numbers (N,) in the 1-norm with rows and columns of one size; inf if singular."""
    conditions = np.full(len(matrices), np.inf)
    for axis in (2, 1):
        size = np.max(np.abs(matrices), axis=axis, keepdims=True, initial=0.0)
        matrices = matrices / np.where(size > 0.0, size, 1.0)
    if not matrices.shape[1]:
        return np.ones(len(matrices))
    signs, _ = np.linalg.slogdet(matrices)
    some = np.flatnonzero(signs)
    norms = [
        np.sum(np.abs(m), axis=1).max(axis=1) for m in (matrices[some], np.linalg.inv(matrices[some]))
    ]
    conditions[some] = norms[0] * norms[1]
    return conditions


LOST = 2.0**-40  # of the size of an entry: an error that is worth the work
_NEGLIGIBLE = 1e-6  # of what its row and column give an entry: the least that its error is relative to
_MOST = 5e8  # operations of the solutions of all points, about a second: more points stay in doubles


def with_digits(a: LFT, points: Array, values: Array) -> Array:
    """Values (N, n_out, n_in) at points (N, number of blocks), better ones where digits are lost.

    `values` are those in doubles. What is lost is seen at the points that are farthest from zero.
    """
    return in_twofold(a, points) if needs_digits(a, points, values) else values


def in_twofold(a: LFT, points: Array) -> Array:
    """Values (N, n_out, n_in) at points (N, number of blocks), by residuals of twice the precision."""
    spread = np.repeat(points, [block.size for block in a.blocks], axis=1)
    loops = (np.eye(a.order) - a.M11 * deltas for deltas in spread)  # each value is rounded once
    solved = (rounding.solve_twofold(loop, a.M12) for loop in loops)
    both = zip(spread, solved, strict=True)
    return np.array([rounding.multiply_add(a.M22, a.M21 * deltas, x) for deltas, x in both])


def needs_digits(a: LFT, points: Array, values: Array) -> bool:
    """Whether values in doubles lose digits that are worth their work."""
    if not a.order or a.is_complex or not len(points) or len(points) * a.order**3 > _MOST:
        return False
    if isinstance(a, SparseLFT):
        return False
    far = {int(np.argmax(size)) for size in (np.max(np.abs(points), 1), np.sum(np.abs(points), 1))}
    spread = np.repeat(points, [block.size for block in a.blocks], axis=1)
    return any(lost(a, spread[k], values[k]) > LOST for k in far)


def lost(a: LFT, deltas: Array, value: Array) -> float:
    """About the largest error of a value (n_out, n_in) at deltas (order,), relative to its entries."""
    loop = np.eye(a.order) - a.M11 * deltas
    solved = np.linalg.solve(loop, a.M12)
    residual = a.M12 - (solved - a.M11 @ (deltas[:, None] * solved))
    change = np.abs((a.M21 * deltas) @ np.linalg.solve(loop, residual))
    rows, columns = equilibrate(value[None])
    size = np.maximum(np.abs(value), _NEGLIGIBLE / np.outer(rows, columns))
    return float(np.max(change / size, initial=0.0))


def value_by_program(
    model: System, lft: LFT, values: Mapping[str, ArrayLike], points: Array
) -> Array | None:
    """Values (N, n_out, n_in) by the program that a model knows; None if another way is taken.

    `lft` is that of the model or of its trim, `points` (N, n_p) are the deltas at the physical values.
    Where a pivot of the program has lost digits, and there only, the LFT may be singular.
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

    by_program = sampling.evaluate_known(lft, points, known, physical, check)
    # the LFT may then be evaluated with more digits than the equations have
    return None if by_program is None or needs_digits(lft, points, by_program) else by_program


@arguments_checked
def computed_by(model: System, count: int) -> str:
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
    """
    if not isinstance(count, int) or count < 0:
        raise StructureError(f"computed_by: expected a number of samples, got {count!r}.")
    known = model.known_program
    way_taken = sampling.way(model.lft, count, known)
    if way_taken == sampling.KNOWN and known is not None:
        return way_taken + ", native" * sampling.is_native(count)
    return way_taken + ", native" * (
        way_taken == sampling.OWN and count >= sampling.NATIVE and is_available()
    )
