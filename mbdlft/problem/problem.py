"""The waist between front ends and the pipeline: what a scene, a matrix, or any other source becomes.

A front end makes one `Problem`. Everything after it (extraction, reduction, bound, search, check,
certificate) knows nothing else, and exists once.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.parameter import BilinearMap, Parameter
from mbdlft.base.unit import Signal
from mbdlft.problem.relations import LinearModel

Complex = NDArray[np.complex128]
Stage = Callable[[str], AbstractContextManager[object]]  # times what is done in it, by its name


class Nouns(NamedTuple):
    """How messages name a problem."""

    # kind, name: such as "scene" and "arm"
    kind: str
    name: str
    truth: str  # what the model is checked against, such as "the nonlinear equations"
    badly_scaled: str  # why rounding may be large, a clause
    # what helps beside narrower ranges where the model is singular; begins with a comma
    narrow: str = ""

    @property
    def owner(self) -> str:
        """Such as "scene 'arm'"."""
        return f"{self.kind} {self.name!r}"


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """One way to write the linear relations of a problem; all forms have the same solution."""

    relations: LinearModel  # solved for their unknown signals they give [A B ; C D]
    # for each parameter: from deltas to the symbols of the relations, if these are not the
    # internal values
    maps: tuple[BilinearMap, ...] | None = None
    # the relations are those of the transpose; they have no derivatives then
    is_transposed: bool = False
    # made from the values of the matrix: numbers are not those of the problem, and unknown signals may be
    # undetermined where the matrix is finite
    is_from_values: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Values of [A B ; C D] at points, by another computation: what a model is checked against."""

    values: Array  # (N, rows, columns)
    scale: Array  # (rows, columns), what the error of an entry is relative to
    # relative error that leaving out states has made, by the values with and without them
    omitted: float
    # `scale` and `omitted` for entries that are nothing but rounding of terms that cancelled
    if_cancelled: Callable[[], tuple[Array, float]]
    # sizes (N, rows, columns) if nothing cancelled, which rounding of the data is relative to
    sizes: Callable[[], Array]
    least: Array  # (rows, columns), of a value: a smaller one is negligible at a point
    trimmed: Array  # (N, n_t), trimmed quantities
    trim_scale: Array  # (n_t,)
    # function of positions among the points and of frequencies (F,) in rad/s: transfer functions
    # (N, F, n_y, n_u)
    transfers: Callable[[Sequence[int], Array], Complex]
    # the same in 50 digits, rounded at the end
    transfers_in_digits: Callable[[Sequence[int], Array], Complex]
    # function of some of the points (N, n_p), or None: values there in 50 digits, rounded at the
    # end; None where `values` are that already
    in_digits: Callable[[Array], Array] | None = None
    # `trim_scale` for quantities that are nothing but rounding of terms that
    # cancelled already in the numbers of the problem: at least a part of what a displacement of 1
    # rad or 1 m makes of them
    trim_if_cancelled: Callable[[], Array] | None = None


class TrimRelations(NamedTuple):
    """What the equilibrium is held by: relations linear in it, names, numbers at nominal."""

    relations: LinearModel
    signals: tuple[Signal, ...]
    nominal: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Linear relations with parameters, and what is needed to make a certified model of them."""

    nouns: Nouns
    description: str
    text: str  # TOML text that the problem can be made from again, for the provenance
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    parameters: tuple[Parameter, ...]  # sorted by name
    forms: tuple[Form, ...]  # ways to write the relations, all of which are looked at
    points: Array  # (N, n_p), physical values at which models are checked; the first is nominal
    reference: Callable[[], Reference]  # values at the points
    # ways that are looked at only while the order is above its bound
    more_forms: Callable[[], Sequence[Form]] = tuple
    # function of a condition number and of names of states: what to say where the relations cannot
    # be solved at nominal
    singular: Callable[[float, Sequence[str]], str] = lambda number, names: "singular"
    trim: TrimRelations | None = None
    # row_units, column_units: arrays (rows,) and (columns,) of powers of two, or None: the
    # relations are those of the matrix with rows and columns divided by these
    row_units: Array | None = None
    column_units: Array | None = None
    # whether the relations are proved to determine the unknown signals
    # at every value of the parameters; False says that it was not proved
    is_regular: Callable[[], bool] = lambda: False
    # of closed loops with constraints G: relations 0 = G y - s of the coordinates that follow, which are
    # regular only where 0 = G G' y - s of all are, and these where the constraints are independent
    constraints: Callable[[], tuple[LinearModel, LinearModel] | None] = lambda: None
    # guaranteed bound of the error of equilibrium positions that are fits; 0.0 if there are none
    fit_error_bound: float = 0.0
