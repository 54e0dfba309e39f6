"""Models with nonlinear functions of signals left in: the Delta-Theta form. numpy only.

xdot  = A x + B_w w + B_zeta zeta + B_u u           w    = Delta z
z     = ...                                          zeta = Theta(omega)
omega = C_omega x + ...
y     = C_y x + ...

Source: F. Casella, F. Donida, M. Lovera, Automatic generation of LFTs from object-oriented non-linear
models with uncertain parameters (2009), equations (1)-(6) and (38)-(43).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError, StructureError, check_known
from mbdlft.base.formula import NUMPY, Functions, formula_value
from mbdlft.base.unit import Signal
from mbdlft.system.model import OUTSIDE, LFTModel

ONE = "one"  # the name of the constant input 1


@dataclass(frozen=True, slots=True)
class Table:
    """Values at breakpoints, joined by lines or cubic polynomials, and lines beyond the ends.

    Attributes
    ----------
    breakpoints : tuple of float (n,)
        Increasing; at least two.
    values : tuple of float (n,)
    below, above : float
        The slopes before the first and behind the last breakpoint.
    slopes : tuple of (left, right) (n - 1,), or empty
        Of cubic polynomials between the breakpoints, their slopes at both ends; lines without.
    """

    breakpoints: tuple[float, ...]
    values: tuple[float, ...]
    below: float
    above: float
    slopes: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        n = len(self.breakpoints)
        if n < 2 or len(self.values) != n or len(self.slopes) not in (0, n - 1):
            raise StructureError(
                f"a table has {n} breakpoints, {len(self.values)} values and {len(self.slopes)} pairs of "
                "slopes: expected two breakpoints or more, a value for each, and a pair for each piece "
                "of a cubic table."
            )
        ends = [x for pair in self.slopes for x in pair]
        every = (*self.breakpoints, *self.values, self.below, self.above, *ends)
        if not all(map(math.isfinite, every)):
            raise StructureError("a table has a number that is not finite.")
        if not all(a < b for a, b in zip(self.breakpoints, self.breakpoints[1:], strict=False)):
            raise StructureError("the breakpoints of a table do not increase.")

    def __str__(self) -> str:
        return f"{'cubic' if self.slopes else 'linear'} table of {len(self.values)} points"

    def __call__(self, argument: ArrayLike) -> Array:
        """Values at arguments, numbers or arrays."""
        return np.asarray(self._values(np.asarray(argument, dtype=float), float), dtype=float)

    def exactly(self, argument: Fraction) -> Fraction:
        """The value at a number, without rounding."""
        value: Fraction = self._values(np.array([argument]), Fraction)[0]
        return value

    def _values(self, a: Any, number: type) -> Any:
        """Values at arguments (N) in a number system."""
        b, v = (np.array([number(x) for x in entries]) for entries in (self.breakpoints, self.values))
        k = np.clip(np.searchsorted(b, a, side="right") - 1, 0, len(b) - 2)
        h, rise = np.diff(b), np.diff(v)
        t = (a - b[k]) / h[k]
        inside = v[k] + t * rise[k]
        if self.slopes:
            start, end = (np.array([number(x) for x in ends]) for ends in zip(*self.slopes, strict=True))
            bend = (1 - t) * (h * start - rise)[k] - t * (h * end - rise)[k]
            inside = inside + t * (1 - t) * bend
        inside = np.where(a < b[0], v[0] + number(self.below) * (a - b[0]), inside)
        return np.where(a > b[-1], v[-1] + number(self.above) * (a - b[-1]), inside)


def named_tables(tables: Sequence[Table]) -> dict[str, Table]:
    """Tables by the names that they have in a text, `table1` and so on."""
    return {f"table{k}": table for k, table in enumerate(tables, start=1)}


@dataclass(frozen=True, slots=True)
class ThetaFunction:
    """zeta = text(arguments), a nonlinear function without parameters.

    Attributes
    ----------
    name : str
        Of zeta, an input of the linear part.
    signals : tuple of str
        Of omega, outputs of the linear part.
    arguments : tuple of str
        The names of these in `text`.
    text : str
        A formula, as in `mbdlft.base.formula`.
    ranges : tuple of (low, high)
        Of the arguments, where the function may be evaluated; infinite if nothing is known.
    unit : str
    tables : tuple of Table
        What `table1`, `table2` are in the text.
    """

    name: str
    signals: tuple[str, ...]
    arguments: tuple[str, ...]
    text: str
    ranges: tuple[tuple[float, float], ...]
    unit: str = "1"
    tables: tuple[Table, ...] = ()

    def __str__(self) -> str:
        shown = [f"{name}: {table}" for name, table in named_tables(self.tables).items()]
        behind = f" [{'; '.join(shown)}]" if shown else ""
        return f"{self.name}({', '.join(self.arguments)}) = {self.text}{behind}"

    def __call__(self, *values: Any, functions: Functions = NUMPY) -> Any:
        """The value at arguments, in any number system that has the functions; tables are of numpy."""
        known = dict(zip(self.arguments, values, strict=True))
        return formula_value(self.text, known, {**named_tables(self.tables), **functions})


@dataclass(frozen=True, slots=True, eq=False)
class DeltaThetaModel:
    """A certified linear part, and the nonlinear functions that close it.

    Attributes
    ----------
    linear : LFTModel
        Inputs u, the constant 1 if `has_one`, then zeta; outputs y, then omega.
    functions : tuple of ThetaFunction
    has_one : bool
        Whether the linear part has the constant input ``one``.
    initial : tuple of float
        Consistent values of the states at the nominal parameters.
    zeta_at_start : tuple of float
        The values of the functions there.
    """

    linear: LFTModel
    functions: tuple[ThetaFunction, ...]
    has_one: bool
    initial: tuple[float, ...] = ()
    zeta_at_start: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        where, inputs = f"model {self.linear.name!r}", [s.name for s in self.linear.inputs]
        outputs = [s.name for s in self.linear.outputs]
        check_known("input", self.zeta, inputs, where, StructureError)
        check_known("output", self.omega, outputs, where, StructureError)

    def __repr__(self) -> str:
        theta = f"Theta {len(self.functions)} x {len(self.omega)}"
        return f"<DeltaThetaModel {self.linear!r}; {theta}>"

    @property
    def name(self) -> str:
        """That of the linear part."""
        return self.linear.name

    @property
    def zeta(self) -> tuple[str, ...]:
        """Names of the outputs of Theta."""
        return tuple(function.name for function in self.functions)

    @property
    def omega(self) -> tuple[str, ...]:
        """Names of the inputs of Theta, each once."""
        return tuple(dict.fromkeys(name for f in self.functions for name in f.signals))

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """u."""
        internal = {*self.zeta, *([ONE] if self.has_one else [])}
        return tuple(s for s in self.linear.inputs if s.name not in internal)

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """y."""
        return self.linear.outputs[: len(self.linear.outputs) - len(self.omega)]


def allowed_range(low: float, high: float) -> tuple[float, float]:
    """A range, and what rounding may leave a value outside of it."""
    finite = high - low if math.isfinite(high - low) else 0.0
    margin = OUTSIDE * (finite + max(abs(x) for x in (low, high, 0.0) if math.isfinite(x)))
    return low - margin, high + margin


def theta_values(
    functions: tuple[ThetaFunction, ...], omega: Mapping[str, ArrayLike], *, check: bool = True
) -> dict[str, Array]:
    """Values of the functions by their names.

    Parameters
    ----------
    functions : tuple of ThetaFunction
    omega : mapping of names of signals to numbers or arrays
    check : bool
        Whether arguments outside of their ranges are an error.

    Raises
    ------
    AnalysisError
        An argument is outside of its range, and `check` is true.
    """
    by_name = {}
    for f in functions:
        values = {}
        for signal, argument, (low, high) in zip(f.signals, f.arguments, f.ranges, strict=True):
            check_known("signal", [signal], omega, f.name, StructureError)
            value = np.asarray(omega[signal], dtype=float)
            least, most = allowed_range(low, high)
            if check and (np.any(value < least) or np.any(value > most)):
                worst = float(np.ravel(value)[np.argmax(np.abs(np.ravel(value)))])
                raise AnalysisError(
                    f"function {f.name!r} is evaluated at {signal} = {worst:g}, outside of its range "
                    f"[{low:g}, {high:g}]. Widen the range of the variable, or keep the signal inside."
                )
            values[argument] = value
        by_name[f.name] = np.asarray(f(*(values[name] for name in f.arguments)), dtype=float)
    return by_name
