"""The margin of robust stability by multipliers: for blocks of all kinds, and for many parameters.

1/margin is the largest structured singular value over all frequencies. It is bounded from above by
multipliers on intervals of frequency (`mbdlft.analyze.coverage`), and from below by deltas that make
the loop singular at one frequency, or, for parameters only, that move a pole to the axis.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.analyze.coverage import Sweep, swept
from mbdlft.analyze.intervals import Channels, balance, channels_matrix
from mbdlft.analyze.multipliers import Structure, structure_of
from mbdlft.analyze.pole_migration import Crossing, smallest_crossing
from mbdlft.analyze.realization import physical, realization, shares
from mbdlft.analyze.result import Bounds, Progress
from mbdlft.analyze.small_delta import small_delta
from mbdlft.base.array import Array
from mbdlft.bound.evidence import IntervalProof, Multipliers
from mbdlft.lft.lft import check
from mbdlft.system.system import System

_MOST_ENTRIES = 1200  # of multipliers: more take minutes for one frequency
_INSIDE = 1.0 - 1e-15  # a margin is not above 1/beta, however it was rounded
_LOOKS = 9  # frequencies around the peak at which deltas are looked for


def by_multipliers(
    system: System,
    stay: Sequence[int],
    gap: float,
    work: float,
    largest: float,
    progress: Progress | None,
    leave_out: tuple[str, ...] = (),
) -> Bounds:
    """Bounds of the margin; arguments are those of `robust_stability`."""
    check(not system.lft.is_complex, "the margin of a system needs real entries; one is complex")
    structure = structure_of(system.lft.blocks)
    channels, scale = channels_of(system, stay, structure)
    reason, sweep = "", Sweep(None, 0.0, np.nan, np.nan)
    best: tuple[float, dict[str, Any], float, Array] = (np.inf, {}, np.nan, np.zeros(0))
    if len(structure.rows) > _MOST_ENTRIES:
        reason = (
            f"multipliers have {len(structure.rows)} entries, more than the {_MOST_ENTRIES} that are "
            "carried: fewer repetitions, or fewer parameters, are needed for a proof"
        )
    try:
        if not reason:
            sweep = swept(channels, structure, gap, work, 1.0 / largest)
            sweep = sweep._replace(proof=_unscaled(sweep.proof, scale))
        lower = min(_INSIDE / sweep.proof.beta, largest) if sweep.proof else 0.0
        if progress is not None:
            progress(lower, np.inf)
        best = _reached(system, stay, sweep, largest)
    except KeyboardInterrupt:
        reason = "it was interrupted"
        lower = min(_INSIDE / sweep.proof.beta, largest) if sweep.proof else 0.0
    if progress is not None:
        progress(lower, best[0])
    return replace(_answer(system, lower, best, sweep, reason, gap), leave_out=leave_out)


def _unscaled(proof: IntervalProof | None, scale: Array) -> IntervalProof | None:
    if proof is None:
        return None
    return proof._replace(multipliers=tuple(scaled(m, 1.0 / scale) for m in proof.multipliers))


def _answer(
    system: System,
    lower: float,
    best: tuple[float, dict[str, Any], float, Array],
    sweep: Sweep,
    reason: str,
    gap: float,
) -> Bounds:
    upper, delta, frequency, slope = best
    names = [block.name for block in system.lft.blocks if block.size]
    real = {name: value for name, value in delta.items() if name in system.parameters.names}
    if not reason and sweep.proof is None:
        reason = f"nothing could be proved near {sweep.open_at:.4g} rad/s with this work"
    if not reason and lower < upper * (1.0 - gap):
        reason = (
            "multipliers cannot prove more on the whole box, and no smaller delta was found; the "
            f"bound is largest near {sweep.frequency:.4g} rad/s"
        )
    values = np.array([float(v) for v in real.values()])
    parts = values * slope if len(slope) == len(values) == len(names) else np.zeros(len(names))
    return Bounds(
        "robust stability",
        lower,
        upper,
        physical(system, list(real), values) if delta else {},
        delta,
        frequency,
        lower > 0.0,
        shares(names, parts) if np.any(parts) else {},
        sweep.work,
        reason,
        sweep.proof,
    )


def channels_of(
    system: System, stay: Sequence[int], structure: Structure
) -> tuple[Channels, Array]:
    """The channels of Delta, balanced, with zeros that make full blocks square; and their scale (m,).

    z and w of each block are multiplied by a power of two, states are, too: nothing is rounded, and Delta
    stays what it is.
    """
    n, size = len(stay), structure.size
    inputs, outputs = structure.inputs, structure.outputs
    B, C, D = np.zeros((n, size)), np.zeros((size, n)), np.zeros((size, size))
    B[:, outputs], C[inputs] = system.B_w[stay], system.C_z[:, stay]
    D[np.ix_(inputs, outputs)] = system.D_zw
    A = system.A[np.ix_(stay, stay)]
    own = balance(A)
    plain = Channels(A * own / own[:, None], B / own[:, None], C * own, D)
    blocks = [max(block.inputs, block.outputs) for block in system.lft.blocks]
    owner = np.repeat(np.arange(len(blocks)), blocks)
    pick = (owner == np.arange(len(blocks))[:, None]).astype(float)
    sizes = [np.abs(channels_matrix(plain, w)[0]) for w in (0.0, *_frequencies(A))]
    scale = balance(pick @ np.max(sizes, axis=0) @ pick.T)[owner]
    B, C = plain.B * scale, plain.C / scale[:, None]
    return Channels(plain.A, B, C, D * scale / scale[:, None]), scale


def scaled(found: Multipliers, scale: Array) -> Multipliers:
    """Multipliers of z and w that are multiplied by one over a scale of powers of two."""
    both = np.outer(scale, scale)
    return found._replace(D=found.D * both, G=found.G * both)


def _frequencies(A: Array) -> list[float]:
    """Sizes of the poles (rad/s)."""
    return [float(w) for w in np.abs(np.linalg.eigvals(A))] if len(A) else []


def _reached(
    system: System, stay: Sequence[int], sweep: Sweep, largest: float
) -> tuple[float, dict[str, Any], float, Array]:
    """The smallest deltas found: their size, by name, the frequency, and slopes of the pole."""
    if system.lft.is_plain:
        gone = [state.name for k, state in enumerate(system.states) if k not in stay]
        found: Crossing = smallest_crossing(realization(system, leave_out=gone), largest)
        names = [block.name for block in system.lft.blocks if block.size]
        delta = dict(zip(names, found.delta.tolist(), strict=True)) if len(found.delta) else {}
        return found.size, delta, found.frequency, found.slope
    A, B, C = system.A[np.ix_(stay, stay)], system.B_w[stay], system.C_z[:, stay]
    channels = Channels(A, B, C, system.D_zw)
    best: tuple[float, dict[str, Any], float, Array] = (np.inf, {}, np.nan, np.zeros(0))
    for omega in _places(A, sweep):
        M, _ = channels_matrix(channels, omega)
        small = small_delta(M, system.lft.blocks)
        if small.bound > 0.0 and 1.0 / small.bound < min(best[0], largest):
            best = (1.0 / small.bound, _by_name(system, small.delta), omega, np.zeros(0))
    return best


def _places(A: Array, sweep: Sweep) -> list[float]:
    """Frequencies at which deltas are looked for."""
    poles = np.abs(np.linalg.eigvals(A)) if len(A) else np.ones(1)
    peak = sweep.frequency
    around = peak * np.geomspace(0.5, 2.0, _LOOKS) if np.isfinite(peak) else np.zeros(0)
    return [float(w) for w in np.unique(np.concatenate([poles, around, [0.0, np.inf]]))]


def _by_name(system: System, delta: NDArray[np.complex128]) -> dict[str, Any]:
    """Numbers and matrices of the blocks of a Delta."""
    rows, columns = system.lft.slices(), system.lft.columns()
    found: dict[str, Any] = {}
    for block in system.lft.blocks:
        part = delta[columns[block.name], rows[block.name]]
        if not block.size:
            continue
        if block.kind == "real":
            found[block.name] = float(part[0, 0].real)
        else:
            found[block.name] = complex(part[0, 0]) if block.kind == "complex" else part
    return found
