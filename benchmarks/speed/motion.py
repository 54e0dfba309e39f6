"""M a + D v + K q = u of chains of revolute joints at rest, derived by hand for numbers of any type.

With z the axis of a joint and p a point of it, a body of mass m at c and all bodies behind joint j,

    M_ij = sum m (z_i x (c - p_i)).(z_j x (c - p_j)) + z_i.J z_j
    K_ij = -sum m g.(z_i x (z_j x (c - p_j))),    joint i before joint j.

Numbers are floats, arrays of many samples, or those of CasADi, SymPy or mpmath. A zero that is known
without their values is the integer 0, and nothing is computed with it.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

Vector = Sequence[Any]
Matrix = list[list[Any]]
GRAVITY = 9.81  # m/s^2, against z
QUARTER: Matrix = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # 90 degrees about y


class Mass(NamedTuple):
    """A body fixed to a link: kg, m, and principal moments about its center in kg m^2."""

    mass: Any
    center: Vector
    inertia: Vector = (0, 0, 0)


class Link(NamedTuple):
    """A link on a revolute joint of the one before.

    `offset` is the place of the joint in the axes of the link before; these are turned by 90 degrees
    about y if `quarter`, then by `angle` (rad) about `axis`, x, y or z.
    """

    offset: Vector
    axis: str
    angle: Any
    bodies: tuple[Mass, ...]
    quarter: bool = False
    stiffness: float = 0.0
    damping: float = 0.0


class Motion(NamedTuple):
    """Matrices at rest: M and K (n, n), D (n,) diagonal, the coordinates that inputs act on.

    `outputs` has for each output its factors of [q, v, a] (3 n).
    """

    M: Matrix
    D: list[Any]
    K: Matrix
    inputs: tuple[int, ...]
    outputs: list[list[Any]]


class Circle(NamedTuple):
    """Cosine and sine of a type of number."""

    cos: Callable[[Any], Any]
    sin: Callable[[Any], Any]


def known_zero(a: Any) -> bool:
    """Whether a number is zero whatever its values."""
    return isinstance(a, int) and a == 0


def add(*terms: Any) -> Any:
    """Their sum."""
    total: Any = 0
    for term in terms:
        if not known_zero(term):
            total = term if known_zero(total) else total + term
    return total


def times(a: Any, b: Any) -> Any:
    """Their product."""
    if known_zero(a) or known_zero(b):
        return 0
    for one, other in ((a, b), (b, a)):
        if isinstance(one, int) and abs(one) == 1:
            return other if one == 1 else -other
    return a * b


def less(a: Any, b: Any) -> Any:
    """Their difference."""
    return add(a, times(-1, b))


def dot(a: Vector, b: Vector) -> Any:
    """Inner product."""
    return add(*(times(x, y) for x, y in zip(a, b, strict=True)))


def cross(a: Vector, b: Vector) -> list[Any]:
    """Cross product."""
    pairs = ((1, 2), (2, 0), (0, 1))
    return [less(times(a[i], b[j]), times(a[j], b[i])) for i, j in pairs]


def chain_motion(links: Sequence[Link], circle: Circle) -> Motion:
    """The matrices of a chain; inputs are all torques, outputs all angles."""
    n = len(links)
    turn: Matrix = [[int(i == j) for j in range(3)] for i in range(3)]
    point: Vector = (0, 0, 0)
    axes: list[list[Any]] = []
    points: list[Vector] = []
    M: Matrix = [[0] * n for _ in range(n)]
    K: Matrix = [[0] * n for _ in range(n)]
    for k, link in enumerate(links):
        point = [add(x, dot(row, link.offset)) for x, row in zip(point, turn, strict=True)]
        if link.quarter:
            turn = product(turn, QUARTER)
        axes.append([row["xyz".index(link.axis)] for row in turn])
        points.append(point)
        turn = product(turn, rotation(link.axis, link.angle, circle))
        seen = [[dot(column, axis) for column in zip(*turn, strict=True)] for axis in axes]
        for body in link.bodies:
            arms = [
                [less(add(x, dot(row, body.center)), y) for x, row, y in zip(point, turn, p, strict=True)]
                for p in points
            ]
            moved = [cross(axis, arm) for axis, arm in zip(axes, arms, strict=True)]
            for j in range(k + 1):
                spun = [times(J, x) for J, x in zip(body.inertia, seen[j], strict=True)]
                for i in range(j + 1):
                    inertia = times(body.mass, dot(moved[i], moved[j]))
                    M[i][j] = add(M[i][j], inertia, dot(seen[i], spun))
                    fall = times(GRAVITY, cross(axes[i], moved[j])[2])
                    K[i][j] = add(K[i][j], times(body.mass, fall))
    for j in range(n):
        for i in range(j):
            M[j][i], K[j][i] = M[i][j], K[i][j]
        if links[j].stiffness:
            K[j][j] = add(K[j][j], links[j].stiffness)
    damping = [link.damping or 0 for link in links]
    outputs = [[int(i == j) for j in range(3 * n)] for i in range(n)]
    return Motion(M, damping, K, tuple(range(n)), outputs)


def product(a: Matrix, b: Matrix) -> Matrix:
    """Of two matrices."""
    return [[dot(row, column) for column in zip(*b, strict=True)] for row in a]


def rotation(axis: str, angle: Any, circle: Circle) -> Matrix:
    """About x, y or z."""
    c, s = circle.cos(angle), circle.sin(angle)
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    found: Matrix = [[0] * 3 for _ in range(3)]
    found[k][k] = 1
    found[i][i], found[i][j], found[j][i], found[j][j] = c, -s, s, c
    return found


def state_space(motion: Motion) -> Matrix:
    """[A B ; C D] with the states [q ; v]."""
    n = len(motion.M)
    right = [
        [times(-1, x) for x in motion.K[i]]
        + [times(-1, motion.D[i]) if i == j else 0 for j in range(n)]
        + [int(i == k) for k in motion.inputs]
        for i in range(n)
    ]
    accelerations = solved(motion.M, right)
    width = 2 * n + len(motion.inputs)
    place = [[int(i == j) for j in range(width)] for i in range(n)]
    rate = [[int(n + i == j) for j in range(width)] for i in range(n)]
    signals = [*place, *rate, *accelerations]
    read = [[dot(row, column) for column in zip(*signals, strict=True)] for row in motion.outputs]
    return [*rate, *accelerations, *read]


def solved(matrix: Matrix, right: Matrix) -> Matrix:
    """matrix^-1 right of a symmetric positive definite matrix, the last unknown first: L D L'."""
    a, b, n = [list(row) for row in matrix], [list(row) for row in right], len(matrix)
    for k in reversed(range(n)):
        for i in (i for i in range(k) if not known_zero(a[i][k])):
            factor = a[i][k] / a[k][k]
            for j in (j for j in range(k) if not known_zero(a[k][j])):
                a[i][j] = less(a[i][j], times(factor, a[k][j]))
            b[i] = [less(x, times(factor, y)) for x, y in zip(b[i], b[k], strict=True)]
    found: Matrix = []
    for k in range(n):
        rest = [less(x, dot(a[k][:k], [row[column] for row in found])) for column, x in enumerate(b[k])]
        found.append([0 if known_zero(x) else x / a[k][k] for x in rest])
    return found
