"""Trims and linearizations at many samples by native code: of a scene, or of a model.

What the native code cannot do at a sample (a pivot loses digits, the equilibrium is not held, something
is not a number) is asked of the source that it was made from, so that each row and status is as there.

The straight-line program of a model: that of the equations of its scene, to be stored with it.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.archive.program import mistake_of
from mbdlft.archive.sweep import SOLVED, Layout
from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError, MbdlftError, MbdlftWarning, StructureError
from mbdlft.base.parameter import Parameter
from mbdlft.batch.program_cache import SceneSource, remember, remembered
from mbdlft.batch.rows import EquationSource, ModelSource, Source, deltas_at, source_of
from mbdlft.batch.samples import GivenSamples, RandomSamples, count_of, points_of, samples_of
from mbdlft.lft.program import native
from mbdlft.lft.program.elimination import closed
from mbdlft.lft.program.tape import Operand, Pivot, Program, Tape, TooLongError, compact, rows_of_numbers
from mbdlft.lft.sampling import LONGEST, NATIVE, ModelProgram
from mbdlft.multibody.scene import Scene, scene_from_toml
from mbdlft.problem.linearization import StraightLine, straight_line
from mbdlft.problem.trim import CARRIED, RESIDUAL, check_carried
from mbdlft.system.model import LFTModel

_WORTH = 50_000  # samples from which on compiling equations takes less than it saves
_CHUNK, _ENTRIES = 8192, 2**22  # most samples, and numbers of their rows (32 MB), at a time
_AT_ONCE = 2**16  # samples at a time, so that their deltas take little memory
_LONGEST = LONGEST
_LONG = 5_000  # instructions of a model: its equations are looked at, which may have fewer
_PROBES, _AGREED = 16, 1e-6  # samples, and part of a row and column: a mistake is more
_ROUNDING = 1e-9  # part of the largest entry below which rows are zero but for rounding


class Linearizations(NamedTuple):
    """State matrices and trims of N samples.

    Attributes
    ----------
    A, B, C, D : arrays (N, nx, nx), (N, nx, nu), (N, ny, nx), (N, ny, nu)
        NaN where a sample has no solution.
    trim : array (N, n_t), in the units of `Compiled.layout.trim`
    status : int array (N,)
        0: solved; 1: singular; 2: no equilibrium. As in sweeps.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    trim: Array
    status: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Compiled:
    """A scene or a model as native code: called with samples, it gives their matrices.

    Attributes
    ----------
    source : EquationSource, SceneSource or ModelSource
        The definition.
    line : StraightLine, or None
        The program; None if there is none, and the definition computes all samples.
    program : NativeProgram, or None
    reason : str
        Why there is no native code; empty if there is.
    threads : int, optional
        By default as many as there are cores.
    is_stored : bool
        Whether the program is the one that the model carries.
    """

    source: EquationSource | SceneSource | ModelSource
    line: StraightLine | None
    program: native.NativeProgram | None
    reason: str = ""
    threads: int | None = None
    is_stored: bool = False

    @property
    def computes(self) -> str:
        """What is computed: "equations" of a scene; the "LFT" or the "stored program" of a model."""
        if self.is_stored:
            return "stored program"
        return "LFT" if isinstance(self.source, ModelSource) else "equations"

    @property
    def layout(self) -> Layout:
        """Names and units of parameters, states, inputs, outputs, trim."""
        return self.source.layout

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sorted by name."""
        return self.source.parameters

    @property
    def chunk(self) -> int:
        """Number of samples that may be evaluated at a time."""
        if self.line is None:
            return self.source.chunk
        return max(64, min(_CHUNK, _ENTRIES // len(self.line.row)))

    def __call__(self, samples: Mapping[str, ArrayLike]) -> Linearizations:
        """State matrices and trims at samples.

        Parameters
        ----------
        samples : mapping of names to numbers or arrays (N,)
            Physical values in the units of the parameters, inside their ranges; a parameter that is not
            named is nominal.
        """
        checked = samples_of(self.parameters, samples)
        assert isinstance(checked, GivenSamples)
        points = points_of(checked, self.parameters, 0, count_of(checked))
        matrices, trim, _, status = self.rows(points)
        matrices_by_name = self.layout.parts(matrices)
        return Linearizations(**matrices_by_name, trim=trim, status=status.astype(np.int64))

    def rows(self, points: Array) -> tuple[Array, Array, Array, Array]:
        """The rows at points (N, n_p), as `Source.rows` describes them."""
        if self.line is None or self.program is None:
            return self.source.rows(points)
        count, entries = len(points), prod(self.line.shape)
        values = native.aligned(count * entries).reshape(count, entries)
        columns = np.repeat(self.line.row[entries:, None], count, axis=1)
        lost = np.zeros(count, dtype=bool)
        for start in range(0, count, _AT_ONCE):
            at_once = slice(start, start + _AT_ONCE)
            arguments, row = self._arguments(points[at_once]), self.line.row[:entries]
            lost[at_once] = native.run_natively(
                self.program, arguments, row, values[at_once], self.threads, columns[:, at_once]
            )
        matrices, status = values.reshape(count, *self.line.shape), np.full(count, float(SOLVED))
        trim, remainders = columns[: self.line.trims].T, columns[self.line.trims :]
        if isinstance(self.source, ModelSource):
            residual = np.full(count, self.source.model.certificate.max_relative_error)
        else:
            residual, carried = remainders[0], remainders[1:]
            lost |= ~(residual <= RESIDUAL)
            if len(carried):
                largest = np.max(np.abs(carried[:, ~lost]), axis=1, initial=0.0)
                if np.any(largest[1:] > CARRIED * largest[0]):
                    check_carried(self.source.equations, largest[1:], float(largest[0]))
        if np.any(lost):
            again = self.source.rows(points[lost])
            matrices[lost], trim[lost], residual[lost], status[lost] = again
        return matrices, trim, residual, status

    def _arguments(self, points: Array) -> Array:
        """What the program is a function of: physical values, or deltas."""
        if not isinstance(self.source, ModelSource) or self.is_stored:
            return points
        return deltas_at(self.source.model, points)


@arguments_checked
def compile(source: Scene | LFTModel, *, threads: int | None = None) -> Compiled:
    """Compile the trim and the linearization of a scene, or the evaluation of a model, to native code.

    The code depends on the structure alone: scenes that differ in numbers and ranges share it. It is
    kept in a folder of this user (`MBDLFT_CACHE`, or the usual one for such files) and read from there
    the next time. Without llvmlite (extra `native`), or where the program would be too long, the
    definition computes, and a warning says so.

    Parameters
    ----------
    source : Scene or LFTModel
        Of a scene, the nonlinear equations are trimmed and linearized at each sample. Of a model, the LFT
        is evaluated; where its program would be long, the equations of the scene that it was made from
        are taken instead, if they have the same values (`Compiled.computes` says which).
    threads : int, optional
        Threads of a call; by default as many as there are cores.
    """
    if threads is not None and (not isinstance(threads, int) or threads < 1):
        raise AnalysisError(f"compile: expected at least 1 thread, got {threads!r}.")
    code = _again(source, threads) if isinstance(source, Scene) else None
    if code is not None:
        return code
    rows = source_of(source)
    code = compiled(rows, threads)
    if isinstance(source, Scene) and isinstance(rows, EquationSource) and not code.reason:
        assert code.line is not None
        remember(source, rows, code.line)
    if code.reason:
        warnings.warn(
            f"compile: {source.name!r} is computed by numpy: {code.reason}", MbdlftWarning, stacklevel=2
        )
    return code


def _again(scene: Scene, threads: int | None) -> Compiled | None:
    """A scene that was compiled before, without assembling it; None if it was not."""
    earlier = remembered(scene) if native.is_available() else None
    if earlier is None:
        return None
    source, line = earlier
    try:
        program = native.compile_native(line.program, prod(line.shape), native.user_cache())
    except Exception:  # it is compiled as if for the first time, and says why
        return None
    return Compiled(source, line, program, "", threads)


def compiled(source: EquationSource | ModelSource, threads: int | None = None) -> Compiled:
    """A source as native code, if that is possible; `reason` says if not."""
    if not native.is_available():
        reason = "llvmlite is not installed (pip install 'mbdlft[native]')."
        return Compiled(source, None, None, reason)
    stored = None if isinstance(source, EquationSource) else _stored(source)
    if isinstance(source, EquationSource):
        line = of_equations(source)
    else:
        line = stored or _of_model(source, _LONGEST)
        if stored is None and (line is None or len(line.program.instructions) > _LONG):
            by_equations = _by_equations(source, threads)
            if by_equations is not None:
                return by_equations
    if line is None:
        return Compiled(source, None, None, f"its program has more than {_LONGEST} instructions.")
    try:
        program = native.compile_native(line.program, prod(line.shape), native.user_cache())
    except Exception as error:
        reason = f"LLVM failed: {type(error).__name__}: {str(error)[:200]}"
        return Compiled(source, None, None, reason)
    code = Compiled(source, line, program, "", threads, stored is not None)
    if not _agrees(code, source):
        return Compiled(source, None, None, "its program differs from the definition; please report it.")
    return code


def of_equations(source: EquationSource) -> StraightLine | None:
    """The program of trim and linearization; None if it would be too long, has no pivots, or states are
    measured from a free mode."""
    if source.need.free:
        return None
    e, inputs, outputs = source.equations, source.inputs, source.outputs
    count = len(e.states)
    kept = source.need.kept(count + len(outputs), count + len(inputs))
    return straight_line(e, inputs, outputs, kept, _LONGEST)


def _stored(source: ModelSource) -> StraightLine | None:
    """The program that a model carries, unless that of its LFT is shorter."""
    model, known = source.model, source.model.known_program
    if known is None or _of_model(source, known.length) is not None:
        return None
    rows, columns = model.lft.shape
    return StraightLine(known.program, known.row, (rows, columns), len(known.row) - rows * columns)


def _of_model(source: ModelSource, longest: int) -> StraightLine | None:
    """The values of both LFTs of a model, from its deltas."""
    model = source.model
    tape, outcome = Tape(len(model.parameters), longest), list[Operand]()
    pivots: list[Pivot] = []
    registers = {p.name: k for k, p in enumerate(model.parameters)}
    lfts = [model.lft] if model.trim.lft is None else [model.lft, model.trim.lft]
    try:
        for lft in lfts:
            entries, some = closed(lft, tape, [registers[block.name] for block in lft.blocks])
            values: list[Operand] = [float(x) for x in lft.M22.ravel()]
            for (i, j), register in entries:
                values[i * lft.shape[1] + j] = register
            outcome += values
            pivots += some
    except TooLongError:
        return None
    shape = (model.lft.shape[0], model.lft.shape[1])
    program, row = rows_of_numbers(tape, outcome, pivots)
    return StraightLine(program, row, shape, len(outcome) - shape[0] * shape[1])


def equations_of(model: LFTModel) -> EquationSource | None:
    """The equations of the scene that a model was made from; None if it is not, or not any more, theirs.

    A model that was truncated has other values; one that was connected has other signals.
    """
    if not model.certificate.exact:
        return None
    try:
        equations = source_of(scene_from_toml(model.provenance.scene))
    except MbdlftError:  # it was made from something else
        return None
    same = equations.layout == ModelSource(model).layout
    same = same and equations.parameters == tuple(model.parameters)
    return equations if same and isinstance(equations, EquationSource) else None


def _by_equations(source: ModelSource, threads: int | None) -> Compiled | None:
    """The equations of the scene that a model was made from, if their values are those of the model."""
    equations = equations_of(source.model)
    if equations is None:
        return None
    code = compiled(equations, threads)
    return None if code.reason or not _agrees(code, source) else code


def _agrees(code: Compiled, definition: Source) -> bool:
    """Whether the values are those of the definition at some samples: there is no mistake."""
    points = points_of(RandomSamples(_PROBES, 0), code.parameters, 0, _PROBES)
    (computed, *_, first), (defined, *_, second) = code.rows(points), definition.rows(points)
    some = (first == SOLVED) & (second == SOLVED)
    if not np.any(some):
        return True
    computed, defined = computed[some], defined[some]
    size = np.max(np.abs(defined), axis=0, initial=0.0)
    rows, columns = np.max(size, axis=1, initial=0.0), np.max(size, axis=0, initial=0.0)
    # rows that are zero but for rounding have no size of their own
    least = np.maximum(size, np.sqrt(np.outer(rows, columns)))
    least = np.maximum(least, _ROUNDING * np.max(size, initial=0.0))
    return bool(np.all(np.abs(computed - defined) <= _AGREED * least))


def fastest(source: EquationSource | ModelSource, count: int) -> Source:
    """The source of the rows of `count` samples: native code if compiling it takes less than it saves."""
    worth = _WORTH if isinstance(source, EquationSource) else NATIVE
    if count < worth or not native.is_available():
        return source
    code = compiled(source, threads=1)
    return source if code.reason else code


@arguments_checked
def with_program(model: LFTModel) -> LFTModel:
    """The model with a straight-line program of its values: the equations of its scene, eliminated.

    Values of an LFT of many repetitions take dense matrices; the program takes sums and products only,
    and `save` stores it, so that whoever loads the model, without CasADi too, evaluates as fast.
    `computed_by` says what `matrices_at` takes.

    Parameters
    ----------
    model : LFTModel
        Made from a scene, as `to_lft` does, and exact.

    Raises
    ------
    StructureError
        It is no such model, or the equations have no program of at most 200 000 instructions, or other
        values than the model.
    """
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
    if mistake_of(known, model.parameters):
        raise StructureError(
            f"{what}: the equations of its scene have other values than the model; please report it."
        )
    return replace(model, program=known)
