"""A system closed through blocks of all kinds, some of which grow: what margins and gains have in common.

    w = Delta z,   |delta_k| or ||Delta_k|| <= k for blocks that grow, <= 1 for those that are fixed.

The margin of robust stability is the largest k for which no Delta makes I - M(j omega) Delta singular.
With a full block that joins inputs and outputs, all blocks growing, it is that of robust performance; if
this block alone grows, 1/k is the worst-case gain (skew mu: Fan, Tits, IEEE TAC 37, 1992).

Nonlinear functions as gains that may move in any way: the loop whose robust stability is asked for.

A function with bounds l <= (f(a) - f(b))/(a - b) <= h of its slope is zeta = k(t) omega between any two
motions, with some k(t) in [l, h]; one in the sector [l, h] is that between a motion and zero. What is
proved for all k(t) is true of the function, as long as its argument stays in the range of these bounds.

Source: H. K. Khalil, Nonlinear Systems, 3rd ed., sections 7.1 (absolute stability) and 8.2 (regions of
attraction).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, StructureError, unknown_name
from mbdlft.base.parameter import Parameter
from mbdlft.lft.block import Block, FullBlock
from mbdlft.lft.lft import LFT, check
from mbdlft.robust.evidence import Multipliers
from mbdlft.robust.mu.intervals import Channels, Extent, balance, channels_matrix
from mbdlft.robust.mu.multipliers import Structure, structure_of
from mbdlft.robust.sector import sector_bounds, slope_bounds
from mbdlft.system.connection import connect
from mbdlft.system.model import Parameters, System
from mbdlft.system.theta import DeltaThetaModel, ThetaFunction

_MOST_ENTRIES = 250  # of multipliers: more take minutes for the whole of the frequencies
GAIN = "(gain)"  # name of the block that joins inputs and outputs
Complex = NDArray[np.complex128]


class Loop(NamedTuple):
    """A system and its blocks, none of which is empty.

    Attributes
    ----------
    channels : Channels
        Balanced by powers of two: z and w of each block are multiplied by the same, so nothing is
        rounded, and Delta stays what it is. Zeros make full blocks square.
    scale : array (m,)
        These powers.
    structure : Structure
    blocks : tuple of Block
    grows : bool array (number of blocks,)
    """

    channels: Channels
    scale: Array
    structure: Structure
    blocks: tuple[Block, ...]
    grows: NDArray[np.bool_]

    @property
    def owner(self) -> NDArray[np.int64]:
        """The block of each channel (m,)."""
        sizes = [max(block.inputs, block.outputs) for block in self.blocks]
        return np.repeat(np.arange(len(sizes)), sizes)

    @property
    def is_plain(self) -> bool:
        """Whether all blocks are real parameters."""
        return all(block.kind == "real" for block in self.blocks)


def loop_of(
    system: System,
    stay: Sequence[int],
    fixed: Iterable[str] = (),
    inputs: Sequence[int] = (),
    outputs: Sequence[int] = (),
) -> Loop:
    """The loop of a system, of the states that stay, and of a block that joins inputs and outputs.

    Raises
    ------
    StructureError
        An entry is complex, or a fixed block is unknown.
    """
    check(not system.lft.is_complex, "the margin of a system needs real entries; one is complex")
    rows, columns, lft = [], [], system.lft
    blocks = [block for block in lft.blocks if block.inputs and block.outputs]
    for block in blocks:
        rows += list(range(*lft.slices()[block.name].indices(lft.M11.shape[0])))
        columns += list(range(*lft.columns()[block.name].indices(lft.M11.shape[1])))
    i, j = list(outputs), list(inputs)
    whole_B = np.hstack([system.B_w[np.ix_(stay, columns)], system.B_u[np.ix_(stay, j)]])
    whole_C = np.vstack([system.C_z[np.ix_(rows, stay)], system.C_y[np.ix_(i, stay)]])
    right = np.vstack([system.D_zu[np.ix_(rows, j)], system.D_yu[np.ix_(i, j)]])
    left = np.vstack([system.D_zw[np.ix_(rows, columns)], system.D_yw[np.ix_(i, columns)]])
    if i and j:
        blocks.append(FullBlock(GAIN, len(i), len(j)))
    kept = check_fixed(system, fixed)
    grows = np.array([block.name not in kept for block in blocks], dtype=bool)
    A = system.A[np.ix_(stay, stay)]
    whole = Channels(A, whole_B, whole_C, np.hstack([left, right]))
    return _balanced(whole, tuple(blocks), grows)


def check_fixed(system: System, fixed: Iterable[str]) -> tuple[str, ...]:
    """Names of fixed blocks, all of which exist.

    Raises
    ------
    StructureError
        A name is unknown.
    """
    names = [block.name for block in system.lft.blocks]
    found = (fixed,) if isinstance(fixed, str) else tuple(fixed)
    for name in found:
        if name not in names:
            raise StructureError(
                f"fixed blocks of {system.name!r}: {unknown_name('block', name, names)}"
            )
    return found


def _balanced(whole: Channels, blocks: tuple[Block, ...], grows: NDArray[np.bool_]) -> Loop:
    structure = structure_of(_pieces(blocks))
    inputs, outputs, size = structure.inputs, structure.outputs, structure.size
    n = len(whole.A)
    B, C, D = np.zeros((n, size)), np.zeros((size, n)), np.zeros((size, size))
    B[:, outputs], C[inputs] = whole.B, whole.C
    D[np.ix_(inputs, outputs)] = whole.D
    own = balance(whole.A)
    plain = Channels(whole.A * own / own[:, None], B / own[:, None], C * own, D)
    loop = Loop(plain, np.ones(size), structure, blocks, grows)
    pick = (loop.owner == np.arange(len(blocks))[:, None]).astype(float)
    sizes = [np.abs(channels_matrix(plain, w)[0]) for w in (0.0, *_frequencies(whole.A))]
    scale = balance(pick @ np.max(sizes, axis=0) @ pick.T)[loop.owner]
    B, C = plain.B * scale, plain.C / scale[:, None]
    return loop._replace(
        channels=Channels(plain.A, B, C, D * scale / scale[:, None]), scale=np.asarray(scale)
    )


def _pieces(blocks: Sequence[Block]) -> list[Block]:
    """Blocks for multipliers: where full ones are too many, repeated blocks are cut into pieces.

    Multipliers that are zero between the pieces are multipliers of the block, too, and prove less.
    """
    most = max((block.size for block in blocks), default=1)
    while True:
        pieces: list[Block] = []
        for block in blocks:
            whole, rest = divmod(block.size, most) if block.kind != "full" else (0, 0)
            count = whole + (rest > 0)
            sizes = [block.size // count + (k < block.size % count) for k in range(count)]
            pieces += [block] if block.kind == "full" else [block.of_size(size) for size in sizes]
        if len(structure_of(pieces).rows) <= _MOST_ENTRIES or most == 1:
            return pieces
        most -= 1


def _frequencies(A: Array) -> list[float]:
    """Sizes of the poles (rad/s)."""
    return [float(w) for w in np.abs(np.linalg.eigvals(A))] if len(A) else []


def unscaled(found: Multipliers, scale: Array) -> Multipliers:
    """Multipliers of the channels as they are, of those of balanced ones."""
    return scaled(found, 1.0 / scale)


def scaled(found: Multipliers, scale: Array) -> Multipliers:
    """Multipliers of balanced channels, of those of the channels as they are."""
    both = np.outer(scale, scale)
    return found._replace(D=found.D * both, G=found.G * both)


def ends_of(loop: Loop, k: float) -> tuple[Array, Array]:
    """Ends (number of blocks,) of the whole box of size k; those of blocks that are not real: norms."""
    size = np.where(loop.grows, k, 1.0)
    return -size, size


def extent_of(loop: Loop, low: Array, high: Array) -> Extent:
    """What multipliers of deltas between these ends have in the place of the box."""
    return Extent((-low * high)[loop.owner], (0.5 * (low + high))[loop.owner])


def matrix_at(loop: Loop, omega: float) -> Complex:
    """M(j omega) (m, m)."""
    return channels_matrix(loop.channels, omega)[0]


def inside(loop: Loop, M: Complex, low: Array, high: Array) -> tuple[Complex, Array]:
    """The matrix (m, m) whose deltas of size 1 are those between the ends, and half sizes (m,).

    With w = c z + v, z = (I - M c)^-1 M v.
    """
    center, half = (0.5 * (low + high))[loop.owner], (0.5 * (high - low))[loop.owner]
    if np.any(center):
        M = np.asarray(np.linalg.solve(np.eye(len(M)) - M * center, M), dtype=complex)
    return half[:, None] * M, half


def loop_of_matrix(M: Complex, blocks: Sequence[Block], grows: NDArray[np.bool_]) -> Loop:
    """A loop without states: its structure, as M (n_z, n_w) is given."""
    structure = structure_of(blocks)
    none = np.zeros((structure.size, structure.size))
    channels = Channels(none[:0, :0], none[:0], none[:, :0], none)
    check(M.shape == (len(structure.inputs), len(structure.outputs)), "M does not fit its blocks")
    return Loop(channels, np.ones(structure.size), structure, tuple(blocks), grows)


Kind = Literal["slope", "sector"]
Ranges = Mapping[str, tuple[float, float]]
_WIDER = 1e-9  # of the width or the size of bounds: they are moved apart by this, for rounding


class _Gain(NamedTuple):
    """One gain: its parameter, the function, and the signal of the argument."""

    parameter: Parameter
    zeta: str
    omega: str


def with_sectors(
    model: DeltaThetaModel, ranges: Ranges | None = None, *, of: Kind = "slope"
) -> System:
    """The system with gains in the place of nonlinear functions, which move in any way within bounds.

    Parameters
    ----------
    model : DeltaThetaModel
    ranges : mapping of names of `model.omega` to (low, high)
        Where the bounds are proved, and what is said of the system is true; the ranges of the functions
        by default.
    of : {"slope", "sector"}
        Slopes: the states, inputs and outputs of the system are the differences of two motions of the
        model with the same parameters, so an equilibrium may depend on them. Sectors: they are those of
        the model, and functions have one argument and are 0 at 0.

    Returns
    -------
    System
        Its parameters are those of the model, and for each function and argument one of the role
        "nonlinear", which `robust_stability` and `worst_case_gain` take as moving in any way; its outputs
        are those of the model, then its omega.

    Raises
    ------
    AnalysisError
        A range is unknown, or not finite; a function has no finite bounds there, or no sector.
    WellPosednessError
        The loop through the gains is singular.
    """
    known = dict(ranges or {})
    for name in known:
        if name not in model.omega:
            raise AnalysisError(f"with_sectors: {unknown_name('argument', name, model.omega)}")
    if of not in ("slope", "sector"):
        raise AnalysisError(f"with_sectors: of: expected 'slope' or 'sector', got {of!r}.")
    if of == "sector" and model.has_one:
        raise AnalysisError(
            f"with_sectors: model {model.name!r} has a constant input, and no equilibrium at zero, which "
            "sectors are around. Take slopes (of='slope'), which hold around each equilibrium."
        )
    taken = {*model.linear.parameters.names}
    gains: list[_Gain] = []
    for f in model.functions:
        own = [_range(f, j, known) for j in range(len(f.signals))]
        for signal, argument, bounds in zip(
            f.signals, f.arguments, _bounds(f, own, of), strict=True
        ):
            name = _identifier(f.name if len(f.signals) == 1 else f"{f.name}_{argument}", taken)
            gains.append(_Gain(_parameter(name, f, bounds), f.name, signal))
    return _closed(model, gains)


def _range(f: ThetaFunction, j: int, known: Ranges) -> tuple[float, float]:
    signal, own = f.signals[j], f.ranges[j]
    low, high = (float(x) for x in known.get(signal, own))
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise AnalysisError(
            f"with_sectors: function {f.name!r}: the range [{low:g}, {high:g}] of {signal} is not "
            f"finite. Give one: ranges={{{signal!r}: (low, high)}}."
        )
    if low < own[0] or high > own[1]:
        raise AnalysisError(
            f"with_sectors: function {f.name!r}: the range [{low:g}, {high:g}] of {signal} is not inside "
            f"that of the function, [{own[0]:g}, {own[1]:g}]."
        )
    return low, high


def _bounds(
    f: ThetaFunction, ranges: list[tuple[float, float]], of: Kind
) -> tuple[tuple[float, float], ...]:
    if of == "sector" and len(f.signals) > 1:
        raise AnalysisError(
            f"with_sectors: function {f.name!r} has {len(f.signals)} arguments, and a sector is of one. "
            "Take slopes (of='slope')."
        )
    found: tuple[tuple[float, float], ...]
    if len(f.signals) == 1:
        proved = sector_bounds(f, *ranges[0])
        found = (getattr(proved, of),)
    else:
        found = slope_bounds(f, ranges)
    for name, bounds in zip(f.signals, found, strict=True):
        if not all(map(math.isfinite, bounds)):
            raise AnalysisError(
                f"with_sectors: function {f} has no finite {of} over the range of {name}: it may jump or "
                "be vertical there, or, for a sector, not be 0 at 0. Take a smaller range, or a model "
                "without the jump."
            )
    return found


def _parameter(name: str, f: ThetaFunction, bounds: tuple[float, float]) -> Parameter:
    low, high = bounds
    more = _WIDER * max(high - low, abs(low), abs(high)) or _WIDER
    low, high = low - more, high + more
    return Parameter(name, 0.5 * (low + high), low, high, role="nonlinear")


def _identifier(name: str, taken: set[str]) -> str:
    plain = "".join(c if c.isalnum() else "_" for c in name).strip("_")
    while plain in taken:
        plain += "_"
    taken.add(plain)
    return plain


def _closed(model: DeltaThetaModel, gains: list[_Gain]) -> System:
    """The linear part with the gains between omega and zeta."""
    linear = model.linear
    inputs = {s.name: s for s in linear.inputs}
    outputs = {s.name: s for s in linear.outputs}
    gains = sorted(gains, key=lambda gain: gain.parameter.name)
    zeta, omega = list(model.zeta), list(model.omega)
    read, act = np.zeros((len(gains), len(omega))), np.zeros((len(zeta), len(gains)))
    middle = np.zeros((len(zeta), len(omega)))
    for k, (parameter, to, of) in enumerate(gains):
        read[k, omega.index(of)] = 1.0
        act[zeta.index(to), k] = parameter.map.gain
        middle[zeta.index(to), omega.index(of)] = parameter.map.b0
    inner = np.diag([-gain.parameter.map.a1 for gain in gains])
    blocks = tuple(Block(gain.parameter.name, 1) for gain in gains)
    between = System(
        "gains",
        LFT(inner, read, act, middle, blocks),
        (),
        tuple(outputs[name] for name in omega),
        tuple(inputs[name] for name in zeta),
        Parameters(gain.parameter for gain in gains),
    )
    u = [s.name for s in model.inputs]
    plain: Any = linear[[s.name for s in linear.outputs], [*u, *zeta]]
    y = [s.name for s in model.outputs]
    return connect([plain, between], inputs=u, outputs=[*y, *omega], name=linear.name)
