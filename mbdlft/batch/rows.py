"""Trims and linearizations at many samples, one row of numbers each.

The equations of a scene are trimmed and linearized again at each sample; an LFT model is evaluated there.
A sample that has no solution is not an error: its row is NaN and has a status.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mbdlft.archive.rows import NO_EQUILIBRIUM, SINGULAR, SOLVED, Layout
from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Signal
from mbdlft.lft.lft import LFT
from mbdlft.lft.sampling import evaluate_at, evaluate_known
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.scene import Scene
from mbdlft.multibody.to_problem import choose_signals, choose_states
from mbdlft.problem.equations import Equations
from mbdlft.problem.linearization import linearized
from mbdlft.problem.relations import Need
from mbdlft.problem.sx.evaluation import MANY
from mbdlft.problem.trim import balance, check_prestress
from mbdlft.system.model import LFTModel
from mbdlft.system.sampled import deltas_of

Indices = NDArray[np.intp]
_CHUNK, _CHUNK_ENTRIES = 4096, 2**21  # most samples, and matrix entries (16 MB), at a time


class Source(Protocol):
    """The source of the rows of a sweep: their layout, and the rows at physical points (N, n_p).

    `chunk` is the number of samples that may be evaluated at a time.
    """

    @property
    def layout(self) -> Layout: ...

    @property
    def parameters(self) -> tuple[Parameter, ...]: ...

    @property
    def chunk(self) -> int: ...

    def rows(self, points: Array) -> tuple[Array, Array, Array, Array]:
        """[A B ; C D] (N, ., .), trim (N, nt), residual (N,), status (N,); rows that failed are NaN."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class EquationSource:
    """The nonlinear equations of a scene, with the inputs, outputs and states that are asked for."""

    equations: Equations
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    need: Need

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sorted by name."""
        return self.equations.parameters

    @property
    def layout(self) -> Layout:
        """Names and shapes."""
        e = self.equations
        return Layout(
            parameters=tuple(Signal(p.name, p.unit) for p in e.parameters),
            states=tuple(e.x_signals[k] for k in self.need.states),
            inputs=tuple(e.u_signals[k] for k in self.inputs),
            outputs=tuple(e.y_signals[k] for k in self.outputs),
            trim=tuple(e.u_signals[k] for k in e.unknown),
        )

    @property
    def chunk(self) -> int:
        """Number of samples that may be evaluated at a time."""
        e = self.equations
        states = len(e.states)
        entries = (states + len(self.outputs)) * (states + len(self.inputs))
        size = min(_CHUNK, _CHUNK_ENTRIES // max(1, entries))
        if size >= MANY:
            return size
        # so few samples are not evaluated as vectors, and the derivatives of all of them are in memory
        rows = e.residual.numel() + len(self.outputs)
        columns = rows + states + len(self.inputs) + len(e.unknown)
        return max(1, min(_CHUNK, _CHUNK_ENTRIES // (rows * columns)))

    def rows(self, points: Array) -> tuple[Array, Array, Array, Array]:
        """The rows at points (N, n_p), as `Source.rows` describes them."""
        count, unknown = len(points), list(self.equations.unknown)
        matrices = np.empty((count, *self.layout.matrix_shape))
        trim, residual = np.full((count, len(unknown)), np.nan), np.full(count, np.nan)
        status = np.full(count, float(SINGULAR))

        def fill(some: Indices) -> None:
            e, at = self.equations, points[some]
            trims = balance(e, at)
            status[some] = np.where(trims.unbalanced, NO_EQUILIBRIUM, SINGULAR)
            good = np.flatnonzero(~trims.unbalanced & np.all(np.isfinite(trims.efforts), axis=1))
            if not len(good):
                return
            efforts, kept = trims.efforts[good], some[good]
            values = self.need.of(linearized(e, self.inputs, self.outputs, at[good], efforts))
            check_prestress(e, at[good], efforts)
            matrices[_as_slice(kept)] = values
            finite = np.all(np.isfinite(values), axis=(1, 2))
            kept = kept[finite]
            trim[kept] = efforts[finite][:, unknown]
            residual[kept], status[kept] = trims.relative[good][finite], SOLVED

        _halves(fill, np.arange(count))
        matrices[status != SOLVED] = np.nan
        return matrices, trim, residual, status


@dataclass(frozen=True, slots=True, eq=False)
class ModelSource:
    """An LFT model; the residual of each row is the error in its certificate."""

    model: LFTModel

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sorted by name."""
        return self.model.parameters

    @property
    def layout(self) -> Layout:
        """Names and shapes."""
        m = self.model
        return Layout(
            parameters=tuple(Signal(p.name, p.unit) for p in m.parameters),
            states=m.states,
            inputs=m.inputs,
            outputs=m.outputs,
            trim=m.trim.signals if m.trim.lft is not None else (),
        )

    @property
    def chunk(self) -> int:
        """Number of samples that may be evaluated at a time."""
        return max(1, min(_CHUNK, _CHUNK_ENTRIES // max(1, int(np.prod(self.model.lft.shape)))))

    def rows(self, points: Array) -> tuple[Array, Array, Array, Array]:
        """The rows at points (N, n_p), as `Source.rows` describes them."""
        m, count = self.model, len(points)
        deltas = deltas_at(m, points)
        matrices = np.full((count, *m.lft.shape), np.nan)
        trim = np.full((count, len(self.layout.trim)), np.nan)
        residual = np.full(count, np.nan)
        status = np.full(count, float(SINGULAR))

        def fill(some: Indices) -> None:
            values = _values(m, m.lft, points[some], deltas[some])
            if m.trim.lft is not None:
                trim[some] = _values(m, m.trim.lft, points[some], deltas[some])[:, :, 0]
            finite = np.all(np.isfinite(values), axis=(1, 2)) & np.all(np.isfinite(trim[some]), axis=1)
            kept = some[finite]
            trim[some[~finite]] = np.nan
            matrices[kept], residual[kept] = values[finite], m.certificate.max_relative_error
            status[kept] = SOLVED

        _halves(fill, np.arange(count))
        return matrices, trim, residual, status


def _values(model: LFTModel, lft: LFT, points: Array, deltas: Array) -> Array:
    """Values of an LFT of a model at physical points (N, n_p), whose deltas are known, too."""
    known = model.known_program
    values = None if known is None else evaluate_known(lft, deltas, known, points)
    return evaluate_at(lft, deltas) if values is None else values


def deltas_at(model: LFTModel, points: Array) -> Array:
    """Deltas (N, n_p) of a model at physical points (N, n_p) in its ranges."""
    deltas = deltas_of(model, {p.name: points[:, k] for k, p in enumerate(model.parameters)})
    return np.broadcast_to(deltas, (len(points), deltas.shape[1]))


def _as_slice(some: Indices) -> slice | Indices:
    """Indices (n,), as a slice if they are consecutive: a slice is copied faster."""
    whole = some[-1] - some[0] + 1 == len(some)
    return slice(int(some[0]), int(some[-1]) + 1) if whole else some


def _halves(fill: Callable[[Indices], None], some: Indices) -> None:
    """Fill the rows `some` (n,) together; if one of them is singular, fill each half of them by itself.

    So the rows are halved down to the singular ones, which stay as they are: NaN, and not converged.
    """
    if not len(some):
        return
    try:
        fill(some)
    except (WellPosednessError, np.linalg.LinAlgError):
        if len(some) > 1:
            middle = len(some) // 2
            _halves(fill, some[:middle])
            _halves(fill, some[middle:])


def source_of(definition: Scene | LFTModel) -> EquationSource | ModelSource:
    """The source of rows of a scene or of a model."""
    if isinstance(definition, LFTModel):
        return ModelSource(definition)
    equations = assemble(definition)
    inputs, outputs = choose_signals(definition, equations)
    need = choose_states(definition, equations, inputs, outputs)
    return EquationSource(equations, tuple(inputs), tuple(outputs), need)
