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
    """How messages name a problem.

    Attributes
    ----------
    kind, name : such as "scene" and "arm"
    truth : what the model is checked against, such as "the nonlinear equations"
    badly_scaled : why rounding may be large, a clause
    narrow : what helps beside narrower ranges where the model is singular; begins with a comma
    """

    kind: str
    name: str
    truth: str
    badly_scaled: str
    narrow: str = ""

    @property
    def owner(self) -> str:
        """Such as "scene 'arm'"."""
        return f"{self.kind} {self.name!r}"


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """One way to write the linear relations of a problem; all forms have the same solution.

    Attributes
    ----------
    relations : LinearModel
        Solved for their unknown signals they give [A B ; C D].
    maps : one for each parameter
        From deltas to the symbols of the relations, if these are not the internal values.
    is_transposed : bool
        The relations are those of the transpose; they have no unknown signals then.
    """

    relations: LinearModel
    maps: tuple[BilinearMap, ...] | None = None
    is_transposed: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Values of [A B ; C D] at points, by another computation: what a model is checked against.

    Attributes
    ----------
    values : array (N, rows, columns)
    scale : array (rows, columns)
        What the error of an entry is relative to.
    omitted : float
        Relative error that leaving out states has made, by the values with and without them.
    if_cancelled : function
        `scale` and `omitted` for entries that are nothing but rounding of terms that cancelled.
    conditioning : function
        Condition and number of changes of sign, as in `Certificate`.
    trimmed : array (N, n_t)
        Trimmed quantities.
    trim_scale : array (n_t,)
    in_digits : function of some of the points (N, n_p), or None
        Values there in 50 digits, rounded at the end; None where `values` are that already.
    trim_if_cancelled : function, or None
        `trim_scale` for quantities that are nothing but rounding of terms that cancelled already in the
        numbers of the problem: at least a part of what a displacement of 1 rad or 1 m makes of them.
    transfers : function of positions among the points and of frequencies (F,) in rad/s
        Transfer functions (N, F, n_y, n_u).
    transfers_in_digits : function of the same
        In 50 digits, rounded at the end.
    """

    values: Array
    scale: Array
    omitted: float
    if_cancelled: Callable[[], tuple[Array, float]]
    conditioning: Callable[[], tuple[float, int]]
    trimmed: Array
    trim_scale: Array
    transfers: Callable[[Sequence[int], Array], Complex]
    transfers_in_digits: Callable[[Sequence[int], Array], Complex]
    in_digits: Callable[[Array], Array] | None = None
    trim_if_cancelled: Callable[[], Array] | None = None


class TrimRelations(NamedTuple):
    """What the equilibrium is held by: relations linear in it, names, numbers at nominal."""

    relations: LinearModel
    signals: tuple[Signal, ...]
    nominal: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Linear relations with parameters, and what is needed to make a certified model of them.

    Attributes
    ----------
    nouns : Nouns
    description : str
    text : str
        TOML text that the problem can be made from again, for the provenance.
    states, inputs, outputs : tuple of Signal
    parameters : sorted by name
    forms : ways to write the relations, all of which are looked at
    more_forms : function without arguments
        Ways that are looked at only while the order is above its bound.
    singular : function of a condition number and of names of states
        What to say where the relations cannot be solved at nominal.
    points : array (N, n_p)
        Physical values at which models are checked; the first is nominal.
    reference : function without arguments
        Values at the points.
    trim : TrimRelations, or None for nothing to trim
    row_units, column_units : arrays (rows,) and (columns,) of powers of two, or None
        The relations are those of the matrix with rows and columns divided by these.
    is_regular : function without arguments
        Whether the relations are proved to determine the unknown signals at every value of the
        parameters; False says that it was not proved.
    fit_error_bound : float
        Guaranteed bound of the error of equilibrium positions that are fits; 0.0 if there are none.
    """

    nouns: Nouns
    description: str
    text: str
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    parameters: tuple[Parameter, ...]
    forms: tuple[Form, ...]
    points: Array
    reference: Callable[[], Reference]
    more_forms: Callable[[], Sequence[Form]] = tuple
    singular: Callable[[float, Sequence[str]], str] = lambda number, names: "singular"
    trim: TrimRelations | None = None
    row_units: Array | None = None
    column_units: Array | None = None
    is_regular: Callable[[], bool] = lambda: False
    fit_error_bound: float = 0.0
