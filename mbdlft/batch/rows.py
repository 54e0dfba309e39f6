"""Rows of a sweep: trims and linearizations at many samples, and what is computed besides.

The equations of a scene are trimmed and linearized again at each sample; an LFT model is evaluated there.
A sample that has no solution is not an error: its row is NaN and has a status. Besides there are poles,
and numbers of a user's own function, which gets many samples at once; each of its numbers depends on one
of them. Samples are halved until those at which it raises an error are alone: their rows have status 3.
"""

import contextlib
import hashlib
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mbdlft.archive.sweep import FUNCTION_FAILED, NO_EQUILIBRIUM, SINGULAR, SOLVED, Layout
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError, WellPosednessError, unknown_name
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Signal
from mbdlft.batch.samples import Samples, count_of, points_of
from mbdlft.exact.rounding import eigenvalues_of
from mbdlft.lft.lft import LFT
from mbdlft.lft.sampling import evaluate_at, evaluate_known
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.scene import Scene
from mbdlft.multibody.to_problem import choose_signals, choose_states
from mbdlft.problem.equations import Equations
from mbdlft.problem.linearization import linearized
from mbdlft.problem.needs import Need
from mbdlft.problem.sx.tapes import MANY
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
            states=self.need.signals(e.x_signals),
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
            values = linearized(e, self.inputs, self.outputs, at[good], efforts)
            values = self.need.of(values, at[good])
            check_prestress(e, at[good], efforts)
            whole = kept[-1] - kept[0] + 1 == len(kept)  # a slice is copied faster than rows one by one
            matrices[slice(kept[0], kept[-1] + 1) if whole else kept] = values
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


_PROBES = 8  # samples at which a function is called to learn what it gives
_SAME = 1e-6  # of the largest: what a number may depend on the samples beside it


@dataclass(frozen=True, slots=True, eq=False)
class SweepPart:
    """Some samples of a sweep, all of them solved, as a function of the user gets them.

    Attributes
    ----------
    samples : mapping of names to arrays (N,), in the units of the parameters
    A, B, C, D : arrays (N, nx, nx), (N, nx, nu), (N, ny, nx), (N, ny, nu)
    trim : array (N, nt)
    layout : names and units of states, inputs, outputs, trim
    """

    samples: Mapping[str, Array]
    A: Array
    B: Array
    C: Array
    D: Array
    trim: Array
    layout: Layout

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues of A (N, nx), sorted by their real, then their imaginary parts."""
        return poles_of(self.A)

    def at(self, some: Any) -> "SweepPart":
        """Some of the samples."""
        return replace(
            self,
            samples={name: column[some] for name, column in self.samples.items()},
            **{key: getattr(self, key)[some] for key in ("A", "B", "C", "D", "trim")},
        )


Function = Callable[[SweepPart], Mapping[str, ArrayLike]]


@dataclass(frozen=True, slots=True)
class Extra:
    """What is asked for besides: as it is written into the plan of a sweep, and sent to workers."""

    poles: bool = False
    function: str = ""  # module:name, or nothing
    names: tuple[str, ...] = ()  # of the numbers that the function gives
    single: bool = False  # whether numbers are stored in single precision

    def layout(self, layout: Layout) -> Layout:
        """The layout of rows with this."""
        return replace(layout, poles=self.poles, functions=self.names, single=self.single)


def poles_of(A: Array) -> NDArray[np.complex128]:
    """Eigenvalues (N, nx) of A (N, nx, nx), sorted by their real, then their imaginary parts."""
    return np.sort(eigenvalues_of(A).astype(complex), axis=-1)


def name_of(function: str | Function) -> str:
    """``module:name`` of a function, which other processes can import."""
    if isinstance(function, str):
        function_of(function)
        return function
    if not callable(function):
        raise AnalysisError(
            f"sweep: expected a function or 'module:name', got {type(function).__name__}."
        )
    text = f"{getattr(function, '__module__', '')}:{getattr(function, '__qualname__', '')}"
    imported: object = None
    if not text.startswith("__main__:"):
        with contextlib.suppress(AnalysisError):
            imported = function_of(text)
    if imported is not function:
        raise AnalysisError(
            f"sweep: the function {text} cannot be imported by other processes, nor when the sweep goes "
            "on after a kill. Put it into a file of its own, NAME.py, and import it from there."
        )
    return text


def function_of(text: str) -> Function:
    """The function ``module:name``; modules are looked for in the working folder, too."""
    module, _, name = text.partition(":")
    if not (module and name) or not module.replace(".", "").isidentifier():
        raise AnalysisError(f"sweep: expected a function as module:name, got {text!r}.")
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path.insert(0, here)
    try:
        member: Any = import_module(module)
    except Exception as error:
        raise AnalysisError(
            f"sweep: function {text}: the module {module} cannot be imported: "
            f"{type(error).__name__}: {error}. Modules of the working folder are found."
        ) from None
    for attribute in name.split("."):
        if not hasattr(member, attribute):
            known = [key for key, value in vars(member).items() if callable(value) and key[0] != "_"]
            raise AnalysisError(f"sweep: function {text}: " + unknown_name("name", attribute, known))
        member = getattr(member, attribute)
    if not callable(member):
        raise AnalysisError(f"sweep: {text} is no function, but {type(member).__name__}.")
    return member  # type: ignore[no-any-return]


def source_digest(text: str) -> str:
    """A digest of the file of a function: a sweep goes on with the same one only."""
    if not text:
        return ""
    try:
        source = inspect.getsource(sys.modules[function_of(text).__module__])
    except (OSError, TypeError, KeyError):
        return "unknown"
    return hashlib.sha256(source.encode()).hexdigest()


def asked_of(
    source: Source, samples: Samples, *, poles: bool, function: str | Function, single: bool
) -> Extra:
    """Check what is asked for; calls of the function at some samples give the names of its numbers."""
    text = name_of(function)
    call, probes = function_of(text), _probed(source, samples, text)
    together, alone, raised = _called(call, probes), list[dict[str, Array]](), ""
    for k in range(len(probes.A)):
        probe = probes.at(slice(k, k + 1))
        numbers = _called(call, probe)
        if isinstance(numbers, Exception):
            at = ", ".join(f"{name} = {column[0]:g}" for name, column in probe.samples.items())
            raised = f"{type(numbers).__name__}: {numbers} at {at}"
            continue
        alone.append(checked(text, numbers, 1))
    if not alone:
        raise AnalysisError(f"sweep: function {text} raised {raised}, and at all others of some samples.")
    names = tuple(alone[0])
    if any(tuple(probe) != names for probe in alone):
        raise AnalysisError(
            f"sweep: function {text} gives {list(names)} at one sample, and other names at another."
        )
    if not isinstance(together, Exception):
        _check_independent(text, checked(text, together, len(probes.A)), alone)
    return Extra(poles=poles, function=text, names=names, single=single)


def _probed(source: Source, samples: Samples, text: str) -> SweepPart:
    """Some samples of a sweep that are solved."""
    count = count_of(samples)
    for probes in (_PROBES, 32 * _PROBES):
        rows = np.unique(np.linspace(0, count - 1, probes).astype(int))
        points = np.concatenate([points_of(samples, source.parameters, int(k), int(k) + 1) for k in rows])
        matrices, trim, _, status = source.rows(points)
        some = np.flatnonzero(status == SOLVED)[:_PROBES]
        if len(some):
            return part_of(source.layout, points[some], matrices[some], trim[some])
    raise AnalysisError(f"sweep: function {text} cannot be tried: none of {len(rows)} samples is solved.")


def part_of(layout: Layout, points: Array, matrices: Array, trim: Array) -> SweepPart:
    """Samples (n, n_p), [A B ; C D] and trim, all of them solved, as functions get them."""
    for array in (points, matrices, trim):
        array.flags.writeable = False  # a function may be called again with a part of them
    samples = {signal.name: points[:, k] for k, signal in enumerate(layout.parameters)}
    return SweepPart(samples, **layout.parts(matrices), trim=trim, layout=layout)


def _called(call: Function, samples: SweepPart) -> Any:
    """What a function gives, or the error that it raises."""
    try:
        with np.errstate(all="ignore"):
            return call(samples)
    except Exception as error:
        return error


def checked(text: str, answer: Any, count: int, names: tuple[str, ...] = ()) -> dict[str, Array]:
    """Numbers (count,) by name, as a function must give them."""
    what = f"sweep: function {text}"
    if not isinstance(answer, Mapping) or not answer or not all(isinstance(k, str) for k in answer):
        raise AnalysisError(
            f"{what}: expected arrays by name, such as {{'bandwidth': ...}}, got {type(answer).__name__}."
        )
    if names and tuple(answer) != names:
        raise AnalysisError(f"{what}: gives {list(answer)}, and {list(names)} at other samples.")
    numbers = {}
    for name, values in answer.items():
        array = np.asarray(values)
        if array.shape != (count,) or array.dtype.kind not in "fiub":
            raise AnalysisError(
                f"{what}: expected {name!r} as {count} real numbers, one for each sample, shape "
                f"({count},), got {array.dtype} of shape {array.shape}."
            )
        numbers[name] = array.astype(float)
    return numbers


def _check_independent(text: str, together: dict[str, Array], alone: list[dict[str, Array]]) -> None:
    """Raise an AnalysisError if what a function gives at a sample depends on the other samples."""
    if len(alone) != len(next(iter(together.values()))):
        return
    for name, values in together.items():
        each = np.array([numbers[name][0] for numbers in alone])
        size = np.max(np.abs(each[np.isfinite(each)]), initial=0.0)
        if not np.allclose(values, each, rtol=0.0, atol=_SAME * size, equal_nan=True):
            raise AnalysisError(
                f"sweep: function {text}: {name!r} at a sample depends on the samples beside it: "
                f"{values.tolist()} together, {each.tolist()} one by one. Use arrays along their first "
                "axis only."
            )


def extras(
    extra: Extra, layout: Layout, points: Array, matrices: Array, trim: Array, status: Array
) -> dict[str, Array]:
    """Poles and numbers of the function, as datasets (N, ...); where it fails, `status` becomes 3."""
    datasets, count = dict[str, Array](), len(points)
    solved = np.flatnonzero(status == SOLVED)
    if extra.poles:
        n = len(layout.states)
        poles = np.full((count, n), complex(np.nan, np.nan))
        poles[solved] = poles_of(matrices[solved, :n, :n])
        datasets |= {"poles/real": poles.real, "poles/imaginary": poles.imag}
    if extra.function:
        values = np.full((count, len(extra.names)), np.nan)
        some = part_of(layout, points[solved], matrices[solved], trim[solved])
        values[solved] = _function_values(extra, function_of(extra.function), some)
        failed = solved[~np.all(np.isfinite(values[solved]), axis=1)]
        values[failed], status[failed] = np.nan, FUNCTION_FAILED
        datasets["function/value"] = values
    return datasets


def _function_values(extra: Extra, call: Function, samples: SweepPart) -> Array:
    """Numbers (n, functions); NaN where the function raises an error."""
    count = len(samples.A)
    if not count:
        return np.empty((0, len(extra.names)))
    answer = _called(call, samples)
    if not isinstance(answer, Exception):
        numbers = checked(extra.function, answer, count, extra.names)
        return np.stack(list(numbers.values()), axis=1)
    if count == 1:
        return np.full((1, len(extra.names)), np.nan)
    halves = (slice(0, count // 2), slice(count // 2, count))
    return np.concatenate([_function_values(extra, call, samples.at(half)) for half in halves])
