"""Small LFTs of a rational matrix F(p) = N(p) / d(p), however it is written: from its values.

**Least multiplicity.** With the other parameters fixed, F is a transfer matrix in p_k. The rank r_k of
its Bezout matrix, the coefficients of (N(s) d(t) - d(s) N(t)) / (s - t), is its McMillan degree: no LFT

    z_k = sum_l M_kl p_l z_l + M_k u,    y = sum_l M_l p_l z_l + M u

has fewer z_k (Fuhrmann, A Polynomial Approach to Linear Algebra, 2012, chapter 8).

**Spaces.** The rows z_k d are polynomial in p, of degrees at most those of F, and for each value of the
other parameters they lie in the row space of the Bezout matrix. All such rows are the module M_k. If its
dimension is r_k, it is the space of z_k in every LFT of least multiplicity: the space is *forced*. Where
all are forced, the rows of N and of all M_k are combinations of those of d and of p_l M_l. One linear
system then has the whole LFT, which is minimal.

**Opening.** Otherwise one parameter is *opened* with a space W_k of dimension r_k: its p_k z_k become
inputs, its z_k outputs, and a rational matrix of one parameter fewer is left. A forced space comes first;
for r_k = 1 rows by the factors of the polynomials; then other spaces inside M_k. The same with columns
for rows.

All choices are made modulo one prime and repeated modulo others, which give the LFT in fractions. An
unlucky choice makes no LFT, or a larger one. It cannot make a wrong one: each step is an identity of
polynomials, and the pipeline compares the values.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import flint
import numpy as np

from mbdlft.exact.modular import Residues, multiplied, powers_of, solved
from mbdlft.order import rational
from mbdlft.order.rational import image_of
from mbdlft.order.work import Work

_ATTEMPTS = 3  # primes that choices are made with: another one has other factors
_MOST_BOX = 700  # monomials times channels: an elimination of so many columns takes half a second
_MORE = 1  # repetitions above the least that are tried: with more, nothing else comes out
_MODULES, _LARGEST_MODULE = 6, 200  # in which a space is chosen; dimension of one
_MOST_SPLITS = 64  # of factors into those of a row and those of a column


class Recovered(NamedTuple):
    """An LFT [z ; y] = M [p z ; u] in exact numbers, with its blocks one after the other."""

    M: rational.Fractions  # (order + rows, order + columns)
    blocks: tuple[tuple[int, int], ...]  # parameter and its multiplicity
    is_minimal: bool = False  # whether all multiplicities are least

    @property
    def order(self) -> int:
        """The sum of the multiplicities."""
        return sum(size for _, size in self.blocks)


def recovered(F: rational.RationalMatrix, work: Work) -> Recovered | None:
    """An LFT with the least multiplicities or a few more, for d(0) != 0; None if none comes out."""
    if math.prod(F.box) * max(len(F.N), len(F.N[0])) > _MOST_BOX:
        return None
    everything = tuple(range(F.parameters))
    for prime in itertools.islice(rational.primes(), _ATTEMPTS):
        least = sum(_degree(F.modulo(prime, work), k) for k in everything)
        for more in range(_MORE + 1):
            first = _realized(F.modulo(prime, work.part(0.5)), everything, least + more)
            if first is not None:
                result = _along_path(F, everything, first, prime, work)
                if result is not None:
                    return result._replace(is_minimal=result.order == least)
                break
        else:
            return None
    return None


def _along_path(
    F: rational.RationalMatrix, left: Sequence[int], first: "_Partial", prime: int, work: Work
) -> Recovered | None:
    """In fractions what came out modulo one prime: at once, or by steps where factors are chosen."""
    budget = sum(size for _, size in first.blocks)

    def whole(prime: int) -> Residues | None:
        again = _realized(F.modulo(prime, work), left, budget, first.path)
        return again.M if again is not None and again.blocks == first.blocks else None

    if not any(isinstance(name, _Factors) for name in first.path):
        M = rational.lifted(whole, work)
        return None if M is None else Recovered(M, first.blocks)
    name, (k, size) = first.path[0], first.blocks[-1]
    step = _named(F.modulo(prime, work), left, budget, name)
    if step is None:
        return None
    if isinstance(name, _Factors):
        W = next(
            (row for row in _rational_rows(F, k) if np.array_equal(image_of(row, prime), step.spaces[k])),
            None,
        )
    else:

        def space(prime: int) -> Residues | None:
            again = _named(F.modulo(prime, work), left, budget, name)
            return None if again is None else again.spaces[k]

        W = rational.lifted(space, work)
    if W is None:
        return None

    def inner(prime: int) -> Residues | None:
        f = F.modulo(prime, work)
        opened = _opened(f.T if step.is_transposed else f, k, image_of(W, prime))
        return (
            None
            if opened is None
            else np.concatenate([opened.N.reshape(-1, *opened.d.shape), opened.d[None]])
        )

    polynomials = rational.lifted(inner, work)
    if polynomials is None:
        return None
    *entries, d = ({e: x for e, x in np.ndenumerate(polynomial) if x} for polynomial in polynomials)
    p, q = size + len(F.N), size + len(F.N[0])
    if step.is_transposed:
        rows = [[entries[j * p + i] for j in range(q)] for i in range(p)]
    else:
        rows = [[entries[i * q + j] for j in range(q)] for i in range(p)]
    following = first._replace(path=first.path[1:], blocks=first.blocks[:-1])
    others = [other for other in left if other != k]
    result = _along_path(rational.RationalMatrix(rows, d, F.parameters), others, following, prime, work)
    return None if result is None else result._replace(blocks=first.blocks)


def _named(f: "rational.Polynomials", left: Sequence[int], budget: int, name: "_Name") -> "_Step | None":
    """The step of a name."""
    steps = _steps(f, _degrees(f, left), budget, name)
    return next((step for step in steps if step.name == name), None)


def _bezout(f: rational.Polynomials, k: int, points: Residues) -> Residues:
    """Bezout matrices (points, p D, q D) in one parameter of degree D, at values of the others."""
    prime, D = f.field.prime, f.d.shape[k] - 1
    N, d = f.at(f.N, points, k), f.at(f.d, points, k)[:, None, None]
    count, p, q = N.shape[:3]
    c = (N[..., :, None] * d[..., None, :] % prime - N[..., None, :] * d[..., :, None] % prime) % prime
    B = np.zeros((count, p, q, D + 1, D + 1), dtype=np.int64)  # its last row and column stay zero
    for i in range(D - 1, -1, -1):
        for j in range(D):
            B[..., i, j] = (c[..., i + 1, j] + (B[..., i + 1, j - 1] if j else 0)) % prime
    return B[..., :D, :D].swapaxes(2, 3).reshape(count, p * D, q * D)


def _degree(f: rational.Polynomials, k: int) -> int:
    """The McMillan degree in a parameter, the others being anything."""
    return f.field.rank(_bezout(f, k, f.field.points(1, f.d.ndim))[0]) if f.d.shape[k] > 1 else 0


def _degrees(f: rational.Polynomials, left: Sequence[int]) -> dict[int, int]:
    """Of the parameters that the matrix depends on."""
    return {k: degree for k in left if (degree := _degree(f, k))}


def _module(f: rational.Polynomials, k: int, degree: int) -> Residues:
    """Rows (dimension, q * box) that lie in the row space of the Bezout matrix at every point."""
    prime, D, shape = f.field.prime, f.d.shape[k] - 1, f.N.shape[1:]
    below = [size - (axis == 1 + k) for axis, size in enumerate(shape)]  # degree below D in p_k
    unknowns, conditions = math.prod(below), shape[0] * D - degree
    space = np.eye(unknowns, dtype=np.int64)
    if conditions:
        others = unknowns // (shape[0] * D)
        points = f.field.points(min(unknowns // conditions, 4 * others) + 3, f.d.ndim)
        zeros = [f.field.null_space(B).T for B in _bezout(f, k, points)]
        points = np.repeat(points, [len(zero) for zero in zeros], axis=0)
        equations: Residues = np.vstack(zeros).reshape(-1, shape[0], D)
        for axis, size in enumerate(f.d.shape):
            if axis != k:
                powers = powers_of(points[:, axis], size, prime)
                powers = powers.reshape(len(points), *[1] * (equations.ndim - 1), size)
                equations = equations[..., None] * powers % prime
        equations = np.moveaxis(equations, 2, 2 + k).reshape(-1, unknowns)
        space = f.field.null_space(equations).T
    rows = np.zeros((len(space), *shape), dtype=np.int64)
    rows[tuple(slice(size) for size in (len(space), *below))] = space.reshape(len(space), *below)
    return f.field.echelon(rows.reshape(len(space), math.prod(shape)))[0]


_Spaces = dict[int, Residues]  # rows (dimension, q * box) of each parameter


def _generated(f: rational.Polynomials, spaces: _Spaces) -> Residues:
    """Rows of p_k W_k for all k, and then of d."""
    return np.vstack([*(f.shifted(W, k) for k, W in spaces.items()), f.constant_rows()])


def _shrunk(f: rational.Polynomials, modules: _Spaces) -> tuple[_Spaces, bool]:
    """What of the modules follows from themselves; whether the rows of N do."""
    while True:
        generated, pivots = f.field.echelon(_generated(f, modules))
        smaller = {k: _intersection(f.field, W, generated, pivots) for k, W in modules.items()}
        if all(len(smaller[k]) == len(W) for k, W in modules.items()):
            N = f.N.reshape(len(f.N), -1)
            return modules, f.field.rank(np.vstack([generated, N])) == len(generated)
        modules = smaller


def _intersection(field: rational.Field, a: Residues, b: Residues, pivots: Sequence[int]) -> Residues:
    """Of the spaces of rows of two matrices, the second in echelon form."""
    outside = (a - multiplied(a[:, pivots], b, field.prime)) % field.prime
    zero = field.null_space(outside.T).T
    return field.echelon(multiplied(zero, a, field.prime))[0] if len(zero) else a[:0]


_Name = str | tuple[Any, ...]  # of a step: a side, or what it begins with


class _Partial(NamedTuple):
    """An LFT modulo a prime, and the names of the steps that led to it."""

    M: Residues
    blocks: tuple[tuple[int, int], ...]
    path: tuple[_Name, ...]


class _Factors(NamedTuple):
    """The name of a step that splits factors, of one prime: others have other factors."""

    parameter: int
    row: tuple[int, ...]


class _Step(NamedTuple):
    """Spaces that close the LFT, or one that opens its parameter; its name is the same for all primes."""

    name: _Name
    f: rational.Polynomials  # or its transpose
    is_transposed: bool
    spaces: _Spaces


def _realized(
    f: rational.Polynomials, left: Sequence[int], budget: int, path: Sequence[_Name] = ()
) -> _Partial | None:
    """An LFT of at most so many repetitions; along a path, if there is one."""
    degrees = _degrees(f, left)
    if sum(degrees.values()) > budget or f.field.work.is_over:
        return None
    if not degrees:  # what is left is constant
        d, N = int(f.d.flat[0]), f.N.reshape(*f.N.shape[:2], -1)[:, :, 0]
        return _Partial(N * pow(d, -1, f.field.prime) % f.field.prime, (), ()) if d else None
    for step in _steps(f, degrees, budget, path[0] if path else None):
        if path and step.name != path[0]:
            continue
        closes = step.name in ("rows", "columns")
        partial = _closed(step) if closes else _opened_and_realized(step, left, budget, path[1:])
        if partial is not None:
            return partial._replace(path=(step.name, *partial.path))
        if path or f.field.work.is_over:
            return None
    return None


def _closed(step: _Step) -> _Partial | None:
    """The LFT of all spaces: rows of z d and N as combinations of those of p_l z_l d and d."""
    f, spaces = step.f, step.spaces
    wanted = np.vstack([*spaces.values(), f.N.reshape(len(f.N), -1)])
    M = f.field.combinations(_generated(f, spaces), wanted)
    if M is None:
        return None
    blocks = tuple((k, len(W)) for k, W in spaces.items())
    return _Partial(M.T if step.is_transposed else M, blocks, ())


def _opened_and_realized(
    step: _Step, left: Sequence[int], budget: int, path: Sequence[_Name]
) -> _Partial | None:
    ((k, W),) = step.spaces.items()
    inner = _opened(step.f, k, W)
    if inner is None:
        return None
    others = [other for other in left if other != k]
    partial = _realized(inner.T if step.is_transposed else inner, others, budget - len(W), path)
    return None if partial is None else partial._replace(blocks=(*partial.blocks, (k, len(W))))


def _opened(f: rational.Polynomials, k: int, W: Residues) -> rational.Polynomials | None:
    """[z_k ; y] of [p_k z_k ; u], by interpolation; None if its degrees are not below those of F."""
    prime, K = f.field.prime, f.d.ndim
    sizes = [1 if axis == k else size for axis, size in enumerate(f.d.shape)]
    nodes = [f.field.points(size) for size in sizes]
    rows = W.reshape(len(W), *f.N.shape[1:])
    shape = (len(W) + f.N.shape[0], len(W) + f.N.shape[1])
    grids = [f.N, f.d, rows]
    for axis in range(K):
        if axis != k:
            powers = powers_of(nodes[axis], f.d.shape[axis], prime)
            grids = [rational.along(a, axis - K, powers, prime) for a in grids]
    N, d = np.zeros((*shape, *sizes), dtype=np.int64), np.zeros(sizes, dtype=np.int64)
    for place in np.ndindex(*sizes):
        line = (..., *(slice(None) if axis == k else i for axis, i in enumerate(place)))
        X = _opened_at(f.field, *(a[line] for a in grids))
        if X is None:
            return None
        d[place] = grids[1][line][0]
        N[(..., *place)] = X * d[place] % prime
    for axis in range(K):
        inverse = solved(
            powers_of(nodes[axis], sizes[axis], prime), np.eye(sizes[axis], dtype=np.int64), prime
        )
        N, d = (rational.along(a, axis - K, inverse, prime) for a in (N, d))
    inner = rational.Polynomials(N, d, f.field)
    point = f.field.points(1, K)
    X = _opened_at(f.field, *(f.at(a, point, k)[0] for a in (f.N, f.d, rows)))
    if X is None or np.any((inner.at(N, point)[0] - X * inner.at(d, point)[0]) % prime):
        return None
    return _trimmed(inner)


def _opened_at(field: rational.Field, N: Residues, d: Residues, W: Residues) -> Residues | None:
    """[A B ; C D] of polynomials in one parameter: N (p, q, D + 1), d (D + 1,), W (n, q, D + 1)."""
    q = N.shape[1]
    columns = q * len(d)
    generated = [np.roll(W, 1, axis=2).reshape(-1, columns)]
    generated.append(np.multiply.outer(np.eye(q, dtype=np.int64), d).reshape(-1, columns))
    wanted = np.vstack([W.reshape(-1, columns), N.reshape(-1, columns)])
    return field.combinations(np.vstack(generated), wanted)


def _trimmed(f: rational.Polynomials) -> rational.Polynomials:
    """In the smallest box."""
    used = np.any(f.N != 0, axis=(0, 1)) | (f.d != 0)
    sizes = [1 + int(np.max(places, initial=0)) for places in np.nonzero(used)]
    box = tuple(slice(size) for size in sizes)
    return f._replace(N=f.N[(slice(None), slice(None), *box)], d=f.d[box])


def _steps(
    f: rational.Polynomials, degrees: Mapping[int, int], budget: int, wanted: _Name | None = None
) -> Iterator[_Step]:
    """What to try, the best first; where no repetition is to spare, forced spaces leave no choice.

    Where the step with one name is `wanted`, steps that have another one may be left out.
    """
    is_tight = sum(degrees.values()) == budget
    ends = is_tight and wanted is None
    sides = []
    for side, g in (("rows", f), ("columns", f.T)):
        if wanted is not None and side not in (wanted, wanted[0]):
            continue
        modules = {k: _module(g, k, degree) for k, degree in degrees.items()}
        spaces, has_all = _shrunk(g, modules)
        if has_all and all(len(spaces[k]) == degree for k, degree in degrees.items()):
            yield _Step(side, g, g is not f, spaces)
        if ends and not (has_all and all(len(spaces[k]) >= degree for k, degree in degrees.items())):
            return
        sides.append((side, g, spaces if is_tight else modules))
    for side, g, spaces in sides:
        for k in sorted(degrees, key=lambda k: -degrees[k]):
            if len(spaces[k]) == degrees[k]:
                yield _Step((side, k), g, g is not f, {k: spaces[k]})
                if ends:
                    return
    for k, degree in degrees.items():
        if degree == 1 and (wanted is None or isinstance(wanted, _Factors)):
            for row in _rows_modulo(f, k):
                yield _Step(
                    _Factors(k, tuple(row.ravel().tolist())), f, is_transposed=False, spaces={k: row}
                )
            if ends:
                return
    proposals = [
        (len(W) - degrees[k], number, k)
        for number, (_, _, spaces) in enumerate(sides)
        for k, W in spaces.items()
        if degrees[k] <= len(W) <= _LARGEST_MODULE
    ]
    for _, number, k in sorted(proposals)[:_MODULES]:
        side, g, spaces = sides[number]
        W = _lowest(g, spaces[k], k, degrees[k])
        yield _Step((side, k, "lowest"), g, g is not f, {k: W})


def _lowest(f: rational.Polynomials, module: Residues, k: int, degree: int) -> Residues:
    """Rows of a module of low degrees in the other parameters: in echelon form, high ones first."""
    degrees = np.zeros(f.N.shape[1:], dtype=int)
    for axis, size in enumerate(f.d.shape):
        if axis != k:
            degrees += np.arange(size).reshape([-1 if a == axis else 1 for a in range(-1, f.d.ndim)])
    order = np.argsort(-degrees.ravel(), kind="stable")
    rows = f.field.echelon(module[:, order])[0][::-1]
    back = np.empty_like(rows)
    back[:, order] = rows
    return back[:degree]


def _rows_modulo(f: rational.Polynomials, k: int) -> Iterator[Residues]:
    """Candidates (1, q * box) of z_k d, modulo a prime."""
    context = flint.nmod_mpoly_ctx.get(
        [f"p{axis}" for axis in range(f.d.ndim)], modulus=f.field.prime, ordering=flint.Ordering.lex
    )
    N, d = (
        [{e: int(x) for e, x in np.ndenumerate(a) if x} for a in b]
        for b in (f.N.reshape(-1, *f.d.shape), f.d[None])
    )
    for row in _rows_by_factors(N, d[0], f.N.shape[1], f.d.shape, k, context):
        yield f.field.echelon(np.array(row, dtype=np.int64).reshape(1, -1))[0]


def _rational_rows(F: rational.RationalMatrix, k: int) -> Iterator[rational.Fractions]:
    """The same in fractions, their first entry that is not zero being 1."""
    context = flint.fmpq_mpoly_ctx.get(
        [f"p{axis}" for axis in range(F.parameters)], ordering=flint.Ordering.lex
    )
    N, d = (
        [{e: flint.fmpq(x.numerator, x.denominator) for e, x in t.items()} for t in ts]
        for ts in (itertools.chain(*F.N), [F.d])
    )
    for row in _rows_by_factors(N, d[0], len(F.N[0]), F.box, k, context):
        flat = [Fraction(int(x.p), int(x.q)) if isinstance(x, flint.fmpq) else Fraction(x) for x in row]
        first = next(x for x in flat if x)
        yield np.array([[x / first for x in flat]], dtype=object)


def _rows_by_factors(
    N: Sequence[Mapping[Any, Any]], d: Mapping[Any, Any], q: int, box: Sequence[int], k: int, context: Any
) -> Iterator[list[Any]]:
    """Rows (q * box) of z_k d where the degree is 1: N_1 d_0 - N_0 d_1 = column * row.

    The factors that all entries share may belong to the row or to the column.
    """

    def polynomial(terms: Mapping[Any, Any], power: int) -> Any:
        return context.from_dict({(*e[:k], 0, *e[k + 1 :]): x for e, x in terms.items() if e[k] == power})

    d0, d1, unit = polynomial(d, 0), polynomial(d, 1), context.constant(1)
    products = [polynomial(x, 1) * d0 - polynomial(x, 0) * d1 for x in N]
    lines = [products[i : i + q] for i in range(0, len(products), q)]
    used = next((line for line in lines if any(x != 0 for x in line)), None)
    if used is None:
        return
    content = _gcd(used)
    row = [divmod(x, content)[0] for x in used]
    place = next(j for j, x in enumerate(row) if x != 0)
    column = [divmod(line[place], row[place])[0] for line in lines]
    shared = _gcd(column)
    _, factors = shared.factor()
    for powers in itertools.islice(itertools.product(*(range(m + 1) for _, m in factors)), _MOST_SPLITS):
        factor = math.prod(
            (base**power for (base, _), power in zip(factors, powers, strict=True)), start=unit
        )
        cofactor = divmod(shared, factor)[0]
        in_row, in_column = ([x * factor for x in row], [divmod(x, shared)[0] * cofactor for x in column])
        if all(_fits(x, box) for x in (*in_row, *in_column)):
            terms = [{tuple(map(int, e)): c for e, c in x.to_dict().items()} for x in in_row]
            yield [t.get(e, 0) for t in terms for e in np.ndindex(*box)]


def _gcd(polynomials: Iterable[Any]) -> Any:
    result = None
    for x in polynomials:
        if x != 0:
            result = x if result is None else result.gcd(x)
    return result


def _fits(polynomial: Any, box: Sequence[int]) -> bool:
    return all(e < size for m in polynomial.monoms() for e, size in zip(m, box, strict=True))
