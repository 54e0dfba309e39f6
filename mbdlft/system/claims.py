"""Whether the matrices of a model contradict what its certificate says of accelerations and what is free.

That is decided on residues; of matrices in doubles it holds but for the rounding of their numbers. With
x' = v and K the entries of the rows of v for x, the matrix M = [K E; F 0], E and F at random, is regular,
and M^-1 = [G R; L g]. K has as many motions R and momenta L as E has columns if g = 0 (nullity theorem).
A column t of the rows of v leaves the momenta if L t = 0, otherwise it moves R b, b = (L R)^-1 L t. A row
r sees no motion if r R = 0; it is the sum r G of those of v if nothing is left of r_t - r G (t - R b).
A change dK changes all of these as it changes M^-1, by -M^-1 dK M^-1.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.base.parameter import at_values, to_physical
from mbdlft.base.reach import in_reach
from mbdlft.exact.rounding import EPS, MOST_ROUNDINGS, or_one, solve_twofold
from mbdlft.lft.lft import LFT, fix
from mbdlft.lft.sampling import evaluate_at, rounding_sizes
from mbdlft.system.model import LFTModel
from mbdlft.system.sampled import in_twofold, places_of

_POINTS = 4  # nominal, and others in the box

Pair = tuple[NDArray[np.intp], NDArray[np.intp]]
Rounded = tuple[Array, Array]  # numbers (N, rows, columns), and sizes: 2.2e-16 of these is rounding


class _Claim(NamedTuple):
    """What fields say of a row and a column: that numbers are zero at some places."""

    fields: str
    says: str
    zero: Rounded
    where: NDArray[np.bool_] | bool = True
    names: tuple[Sequence[str], Sequence[str]] = ((), ())


def check_claims(model: LFTModel) -> None:
    """Raise a StructureError where matrices at nominal or in the box contradict the certificate.

    By more than 100 times what rounding of the numbers of the LFT explains; blocks that are no parameters
    are at zero.
    """
    a, others = model.lft, [block for block in model.lft.blocks if block.kind != "real"]
    if others:
        a = fix(a, {b.name: np.zeros((b.outputs, b.inputs)) if b.kind == "full" else 0.0 for b in others})
    deltas = np.random.default_rng(0).uniform(-1.0, 1.0, (_POINTS, len(a.blocks)))
    deltas[0] = 0.0
    with np.errstate(all="ignore"):
        values = evaluate_at(a, deltas)
        sizes = np.maximum(rounding_sizes(a, deltas), np.abs(values))
        found = _contradiction(model, values, sizes, in_digits=False)
        if found and isinstance(a, LFT) and not a.is_complex:  # doubles may have lost digits
            found = _contradiction(model, in_twofold(a, deltas), sizes, in_digits=True)
    if found:
        physical = [float(to_physical(*p)) for p in zip(model.parameters, deltas[found[0]], strict=True)]
        at = f" at {at_values(model.parameters, physical)}" if physical else ""
        raise StructureError(
            f"model {model.name!r}: certificate, {found[1]}. Its matrices{at} contradict that by "
            f"{found[2]:.1e} times what rounding of their numbers explains, expected at most "
            f"{MOST_ROUNDINGS:g}. The certificate is that of other matrices: make the model again."
        )


def _contradiction(
    model: LFTModel, values: Array, sizes: Array, *, in_digits: bool
) -> tuple[int, str, float] | None:
    """At which point what is contradicted, and by how many roundings; what is no number says nothing."""
    for claim in _claims(model, values, sizes, in_digits=in_digits):
        zero = np.abs(claim.zero[0]) * claim.where
        roundings = np.where(zero == 0.0, 0.0, zero / (EPS * claim.zero[1]))
        roundings[np.isnan(roundings)] = 0.0
        if np.max(roundings, initial=0.0) > MOST_ROUNDINGS:
            k, *at = map(int, np.unravel_index(int(np.argmax(roundings)), roundings.shape))
            names = (of[i % len(of)] if of else "" for of, i in zip(claim.names, at, strict=True))
            fields = ", ".join(name for name in claim.fields.split() if getattr(model.certificate, name))
            said = f"{claim.says.format(*names)}, and {zero[k, *at]:.2g} is left of what is zero then"
            return k, f"{fields}: {said}", float(roundings[k, *at])
    return None


def _claims(model: LFTModel, V: Array, S: Array, *, in_digits: bool) -> Iterator[_Claim]:
    """What is claimed of values V (N, ., .) of [A B ; C D], whose entries are rounded as S says."""
    c, nx, nu, ny = model.certificate, *map(len, (model.states, model.inputs, model.outputs))
    momenta = np.array(c.momenta or [0] * nu, dtype=int)
    motions = np.array(c.rigid_motions or [0] * ny, dtype=int)
    count = int(np.abs([0, *momenta, *motions]).max())
    unmoved = np.zeros((ny, nu), dtype=int)
    unmoved[tuple(np.array(c.unmoved, dtype=int).reshape(-1, 2).T)] = 1
    pairs = places_of(V[:, :nx, :nx], V[:, :nx, nx:], c.beside)
    x, v = (np.array([*places], dtype=int) for places in (pairs, pairs.values()))
    rows, columns = (np.delete(np.arange(nx + n), x) for n in (ny, nu))
    of_rows = [[*model.states, *model.outputs][k].name for k in rows]
    of_columns = [[*model.states, *model.inputs][k].name for k in columns]
    zeros = _zeros(V, S, (x, v), (rows, columns), min(count, len(x)), in_digits=in_digits)
    more, changed, seen, felt, left = zeros
    # what leads where; an unmoved output is led to by states beside, and an input leads to others
    nonzero = np.any(np.abs(V) > MOST_ROUNDINGS * EPS * S, axis=0)
    leads, of_inputs, of_outputs = nonzero[:nx, :nx], nonzero[:nx, nx:], nonzero[nx:, :nx]
    leaves, is_rate, driven = momenta == count, *(np.isin(range(nx), some) for some in (v, c.driven))
    used = np.append(in_reach(leads, of_inputs[:, leaves].any(axis=1)), leaves)[columns]
    blind = np.append(in_reach(leads.T, of_outputs[motions > 0].any(axis=0) | is_rate), motions > 0)[rows]
    to = [
        np.append(in_reach(leads.T, row) & ~is_rate, np.arange(ny) == i)
        for i, row in enumerate(of_outputs)
    ]
    by = [
        np.append(in_reach(leads, row) & ~is_rate, np.arange(nu) == j)
        for j, row in enumerate(of_inputs.T)
    ]
    to_rows, by_columns = (np.reshape(x, (n, nx + n)).T for x, n in ((to, ny), (by, nu)))
    both = to_rows[rows] @ unmoved @ by_columns[columns].T > 0
    sums = np.append(driven, np.isin(range(ny), c.accelerations))[rows]
    own = ~np.append(driven, np.zeros(nu, dtype=bool))[columns]
    one, wrong = np.ones((1, 1, 1)), [model.states[k].name for k in (*x, *v) if driven[k]]
    yield _Claim("driven", "{0} is none of a structure", (one, 0.0 * one), bool(wrong), (wrong, ()))
    if count:
        free = f"there are {count} motions as a rigid body"
        yield _Claim("momenta rigid_motions beside", free, more)
        yield _Claim("momenta beside", "{1} leaves all momenta", changed, used, ((), of_columns))
    if c.rigid_motions:
        blind = np.tile(blind, 2)[:, None]
        yield _Claim(
            "rigid_motions beside", "{0} sees no motion as a rigid body", seen, blind, (of_rows, ())
        )
    fields, said, of = (
        "accelerations driven beside",
        "{0} is a sum of accelerations",
        (of_rows, of_columns),
    )
    yield _Claim(fields, said, seen, np.append(sums, sums & False)[:, None], (of_rows, ()))
    yield _Claim(fields, said + ", by {1} too", left, sums[:, None] & used & own, of)

    if count:
        said = "{0} feels nothing of the rigid motion by {1}"
        yield _Claim("unmoved beside", said, felt, np.tile(both, (2, 1)), of)
        yield _Claim("unmoved accelerations driven", said, left, sums[:, None] & both & own, of)
    elif c.unmoved:
        yield _Claim("unmoved", "there are motions as a rigid body", (one, 0.0 * one))


def _zeros(
    V: Array, S: Array, places: Pair, some: Pair, count: int, *, in_digits: bool
) -> tuple[Rounded, ...]:
    """g; L t; r R of places and, behind, of rates; r R b of both; what is left: of some rows, columns."""
    (x, v), (rows, columns) = places, some
    unit, n, m, p = V[:, x, v][:, None], len(x), len(columns), len(rows)
    X, SX = V[:, :, x] * unit, S[:, :, x] * np.abs(unit) + np.abs(V[:, :, x]) * S[:, x, v][:, None]
    K, SK, t, St = X[:, v], SX[:, v], V[:, v][:, :, columns], S[:, v][:, :, columns]
    r, Sr = (np.concatenate([a[:, rows], b[:, rows][:, :, v]], axis=1) for a, b in ((X, V), (SX, S)))
    M, random = np.pad(K, ((0, 0), (0, count), (0, count))), np.random.default_rng(0)
    size = or_one(np.max(np.abs(K), axis=(1, 2), keepdims=True, initial=0.0))
    M[:, :n, n:], M[:, n:, :n] = (
        size * random.standard_normal(shape) for shape in ((n, count), (count, n))
    )
    Mt, rt, one = M.swapaxes(1, 2), r.swapaxes(1, 2), np.eye(count)
    Z, W = _solved(M, t, one, in_digits), _solved(Mt, rt, one, in_digits).swapaxes(1, 2)
    Lt, R, g, rR, L = Z[:, n:, :m], Z[:, :n, m:], Z[:, n:, m:], W[:, : 2 * p, n:], W[:, 2 * p :, :n]
    N = _solved(L @ R, np.zeros((len(V), count, 0)), one, in_digits)
    b, a, f = N @ Lt, rR @ N, W[:, : 2 * p, :n]
    Y = _solved(M, t - R @ b, one[:0, :0], in_digits)[:, :n]
    aY, aR, aL, af = map(np.abs, (Y, R, L, f))
    # what is zero is rounded to 2.2e-16 of the largest
    for of, axis in ((aY, 1), (aR, 1), (aL, 2), (af, 2)):
        of += EPS * np.max(of, axis=axis, keepdims=True, initial=0.0)
    of_t, of_r, of_b = St + SK @ aY, Sr + af @ SK, aR @ np.abs(b)
    sizes = np.abs(a) @ aL @ (of_t + of_b) + (np.abs(rR) + of_r @ aR) @ np.abs(b)
    felt = rR @ b, sizes
    left = V[:, rows][:, :, columns] - r[:, :p] @ Y
    left_sizes = S[:, rows][:, :, columns] + Sr[:, :p] @ aY + af[:, :p] @ (of_t + of_b)
    return (g, aL @ SK @ aR), (Lt, aL @ of_t), (rR, of_r @ aR), felt, (left, left_sizes)


def _solved(M: Array, right: Array, one: Array, in_digits: bool) -> Array:  # noqa: FBT001
    """M^-1 [right 0; 0 1] with the digits of small entries; not a number where M is singular."""
    right = np.pad(right, ((0, 0), (0, M.shape[1] - right.shape[1]), (0, len(one))))
    right[:, right.shape[1] - len(one) :, right.shape[2] - len(one) :] = one
    solutions = np.full(right.shape, np.nan, dtype=M.dtype)
    for k, (matrix, side) in enumerate(zip(M, right, strict=True)):
        with suppress(np.linalg.LinAlgError):
            if in_digits:
                solutions[k] = solve_twofold(matrix, side).high
            else:
                first = np.linalg.solve(matrix, side)
                solutions[k] = first + np.linalg.solve(matrix, side - matrix @ first)
    return solutions
