"""Systems: linear models with named signals whose parameters are left in. numpy only.

xdot = A   x + B_w  w + B_u  u
z    = C_z x + D_zw w + D_zu u
y    = C_y x + D_yw w + D_yu u,      w = Delta z,   Delta = diag(delta_k I_rk, ...),   -1 <= delta_k <= 1

Operations are imported where they are used: they need scipy, and reading an archive does not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, SupportsIndex, overload

import numpy as np

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import StructureError, unknown_name
from mbdlft.base.notebook import heading, table
from mbdlft.base.parameter import Parameter, to_delta
from mbdlft.base.signal import Signal
from mbdlft.lft.evaluation import ModelProgram, evaluate, evaluate_at
from mbdlft.lft.lft import LFT
from mbdlft.system.digits import with_digits
from mbdlft.system.singular import check_regular_at
from mbdlft.system.straight import value_by_program

if TYPE_CHECKING:
    from control import StateSpace

_OUTSIDE = 1e-9  # of the width of a range: what rounding may leave a value outside


class StateMatrices(NamedTuple):
    """A, B, C, D of one model, or of N with a leading axis; units as those of the signals."""

    A: Array
    B: Array
    C: Array
    D: Array


class Parameters(tuple[Parameter, ...]):
    """Parameters sorted by name: a tuple that also finds them by name, ``parameters["m1"]``."""

    __slots__ = ()

    @overload
    def __getitem__(self, key: SupportsIndex | str) -> Parameter: ...
    @overload
    def __getitem__(self, key: slice) -> tuple[Parameter, ...]: ...
    def __getitem__(self, key: SupportsIndex | slice | str) -> Parameter | tuple[Parameter, ...]:
        if not isinstance(key, str):
            return super().__getitem__(key)
        for parameter in self:
            if parameter.name == key:
                return parameter
        raise StructureError(unknown_name("parameter", key, self.names))

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(parameter.name for parameter in self)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class System:
    """A linear system with its parameters left in: value of `lft` = [A B ; C D].

    Parameters
    ----------
    name : str
    lft : LFT
        Real blocks are the parameters, each with one block, which may be of size 0; complex and full
        blocks are dynamics of which only a bound is known.
    states, inputs, outputs : tuple of Signal
        Signals are named once among the inputs and once among the outputs.
    parameters : tuple of Parameter, sorted by name
        As an attribute it also finds them by name: ``system.parameters["m1"]``.
    description : str

    Raises
    ------
    StructureError
        The real blocks of the LFT are not the parameters, or the shape is not that of the signals.

    Notes
    -----
    With other systems, python-control systems, numbers and matrices: ``a + b``, ``a - b``, ``-a``,
    ``a * b`` and ``a @ b`` (first b, then a), ``a["output", "input"]``; and `feedback`, `connect`,
    `append`, `series` and `lft` of `mbdlft.system`.
    """

    name: str
    lft: LFT
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    parameters: Parameters
    _: KW_ONLY
    description: str = ""

    # numpy leaves the operators of an array on the left to the reflected ones below
    __array_ufunc__ = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", Parameters(self.parameters))
        names = list(self.parameters.names)
        shape = (len(self.states) + len(self.outputs), len(self.states) + len(self.inputs))
        blocks = [block.name for block in self.lft.blocks if block.kind == "real"]
        if blocks != names:
            raise StructureError(
                f"model {self.name!r}: the blocks {blocks} are not the parameters {names}."
            )
        if self.lft.shape != shape:
            raise StructureError(
                f"model {self.name!r}: the signals need shape {shape}, the LFT has {self.lft.shape}."
            )

    def __repr__(self) -> str:
        parts = (("states", self.states), ("inputs", self.inputs), ("outputs", self.outputs))
        sizes = ", ".join(f"{len(signals)} {what}" for what, signals in parts)
        blocks = ", ".join(f"{name} {size}" for name, size in self.lft.blocks)
        kind = type(self).__name__
        return f"<{kind} {self.name!r}: {sizes}; order {self.order}: {blocks or 'no parameters'}>"

    def _repr_html_(self) -> str:
        sizes = dict(self.lft.blocks)
        rows = ((p.name, p.nominal, p.low, p.high, p.unit, sizes[p.name]) for p in self.parameters)
        names = ("parameter", "nominal", "low", "high", "unit", "repetitions")
        return heading(self.name, self.description) + heading("", repr(self)) + table(names, rows)

    @property
    def order(self) -> int:
        """Size of Delta."""
        return self.lft.order

    @property
    def is_proved_regular(self) -> bool:
        """Whether every value in the ranges is proved to have matrices; an `LFTModel` knows."""
        return False

    @property
    def known_program(self) -> ModelProgram | None:
        """A straight-line program of its values; an `LFTModel` may have one."""
        return None

    @property
    def A(self) -> Array:
        """(nx, nx), at delta = 0."""
        return self.lft.M22[: self._nx, : self._nx]

    @property
    def B_w(self) -> Array:
        """(nx, nw)."""
        return self.lft.M21[: self._nx]

    @property
    def B_u(self) -> Array:
        """(nx, nu)."""
        return self.lft.M22[: self._nx, self._nx :]

    @property
    def C_z(self) -> Array:
        """(nw, nx)."""
        return self.lft.M12[:, : self._nx]

    @property
    def D_zw(self) -> Array:
        """(nw, nw)."""
        return self.lft.M11

    @property
    def D_zu(self) -> Array:
        """(nw, nu)."""
        return self.lft.M12[:, self._nx :]

    @property
    def C_y(self) -> Array:
        """(ny, nx)."""
        return self.lft.M22[self._nx :, : self._nx]

    @property
    def D_yw(self) -> Array:
        """(ny, nw)."""
        return self.lft.M21[self._nx :]

    @property
    def D_yu(self) -> Array:
        """(ny, nu)."""
        return self.lft.M22[self._nx :, self._nx :]

    @property
    def _nx(self) -> int:
        return len(self.states)

    def __getitem__(self, key: Any) -> "System":
        return _algebra().selected(self, key)

    def __neg__(self) -> "System":
        return _algebra().negative(self)

    def __add__(self, other: Any) -> "System":
        return _algebra().combine(self, other)

    def __radd__(self, other: Any) -> "System":
        return _algebra().combine(other, self)

    def __sub__(self, other: Any) -> "System":
        return _algebra().combine(self, other, -1.0)

    def __rsub__(self, other: Any) -> "System":
        return _algebra().combine(other, self, -1.0)

    def __mul__(self, other: Any) -> "System":
        return _algebra().chain([other, self])

    def __rmul__(self, other: Any) -> "System":
        return _algebra().chain([self, other])

    def __truediv__(self, number: float) -> "System":
        return self * (1.0 / number)

    __matmul__, __rmatmul__ = __mul__, __rmul__

    def with_range(
        self, ranges: Mapping[str, Sequence[float]] | None = None, /, **named: Sequence[float]
    ) -> Self:
        """The model with other ranges of parameters inside the old ones, as many repetitions.

        Parameters
        ----------
        ranges : mapping of names to (low, high) or (low, nominal, high), in their units, optional
        named : ranges by name, besides those of `ranges`

        Returns
        -------
        System, or LFTModel if this is one
            Its value at each physical value is the same. Without a nominal value the old one stays if it
            lies inside; else the middle is taken.

        Raises
        ------
        StructureError
            A range reaches beyond the old one, where nothing was checked.
        """
        from mbdlft.system.ranges import with_ranges  # here because it needs scipy

        return with_ranges(self, {**(ranges or {}), **named})

    def at(self, values: Mapping[str, Any] | None = None, /, **named: Any) -> "StateSpace":
        """The model at physical values by name, in their units; the others are nominal.

        Parameters
        ----------
        values : mapping of names to numbers, optional
        named : numbers by name, besides those of `values`

        Returns
        -------
        control.StateSpace
            With the names of the signals; python-control does not allow dots, so ``shoulder.torque``
            is named ``shoulder_torque``.
        """
        import control  # here because it is slow to import and reading an archive does not need it

        given = {**(values or {}), **named}
        full = {block.name for block in self.lft.blocks if block.kind == "full"}
        for name, value in given.items():
            if np.ndim(value) != 2 * (name in full):
                raise StructureError(
                    f"model {self.name!r}: at() takes one number for {name}; for arrays use "
                    "matrices_at(model, values)."
                )
        matrices = matrices_at(self, given)
        if any(matrix.dtype.kind == "c" and matrix.imag.any() for matrix in matrices):
            raise StructureError(
                f"model {self.name!r}: its matrices are complex there, which python-control does not "
                "allow; use matrices_at(model, values)."
            )
        return control.ss(
            *(matrix.real for matrix in matrices),
            name=self.name.replace(".", "_"),
            states=[signal.name.replace(".", "_") for signal in self.states],
            inputs=[signal.name.replace(".", "_") for signal in self.inputs],
            outputs=[signal.name.replace(".", "_") for signal in self.outputs],
        )


class _Algebra(Protocol):
    """What `mbdlft.system.algebra` has for operators."""

    def selected(self, a: System, key: Any) -> System: ...
    def negative(self, a: System) -> System: ...
    def combine(self, a: Any, b: Any, sign: float = 1.0) -> System: ...
    def chain(self, items: Sequence[Any]) -> System: ...


def _algebra() -> _Algebra:
    from mbdlft.system import algebra  # here: it needs scipy, and reading an archive does not

    return algebra


def deltas_of(model: System, values: Mapping[str, ArrayLike]) -> Array:
    """Normalized deltas (N, n_p) [1] of physical values by name; the others are nominal.

    Raises
    ------
    StructureError
        A name is unknown, a value lies outside the range, or the lengths differ.
    """
    names = [parameter.name for parameter in model.parameters]
    if not isinstance(values, Mapping):
        raise StructureError(
            f"model {model.name!r}: expected values by name, such as {{'{(names or ['m'])[0]}': 1.0}}, "
            f"got {values!r}."
        )
    for name in values:
        if name not in names:
            raise StructureError(f"model {model.name!r}: " + unknown_name("parameter", name, names))
    for name, value in values.items():
        if not np.issubdtype(np.asarray(value).dtype, np.number):
            raise StructureError(f"model {model.name!r}: {name}: expected a number, got {value!r}.")
    arrays = {name: np.atleast_1d(np.asarray(value, dtype=float)) for name, value in values.items()}
    lengths = {len(array) for array in arrays.values()} - {1}
    if len(lengths) > 1 or any(array.ndim != 1 for array in arrays.values()):
        raise StructureError(
            f"model {model.name!r}: values of parameters must be numbers or arrays of one length, "
            f"got shapes {sorted({array.shape for array in arrays.values()})}."
        )
    points = np.zeros((max(lengths, default=1), len(names)))
    for k, parameter in enumerate(model.parameters):
        if parameter.name not in arrays:
            continue
        array = arrays[parameter.name]
        slack = _OUTSIDE * (parameter.high - parameter.low)
        wrong = ~((array >= parameter.low - slack) & (array <= parameter.high + slack))
        if np.any(wrong):
            raise StructureError(
                f"model {model.name!r}: {parameter.name} = {array[wrong][0]:g} is outside its range "
                f"[{parameter.low:g}, {parameter.high:g}] {parameter.unit}. Widen the range in the "
                "scene and linearize again."
            )
        points[:, k] = to_delta(parameter, array)
    return points


def matrices_at(model: System, values: Mapping[str, ArrayLike]) -> StateMatrices:
    """State matrices at physical values by name.

    Parameters
    ----------
    model : System or LFTModel
    values : mapping of names to numbers or arrays (N,), in the units of the parameters
        The others are nominal. Blocks that are not parameters may be named, too: their deltas [1],
        matrices for full blocks, which are zero otherwise.

    Returns
    -------
    StateMatrices
        A (nx, nx) and so on for numbers; A (N, nx, nx) and so on if any value is an array.

    Raises
    ------
    StructureError
        A name is unknown, a value lies outside its range, or the lengths differ.
    WellPosednessError
        The model is singular at one of the points, exactly or to working precision.
    """
    value = value_at(model, model.lft, values)
    n = len(model.states)
    return StateMatrices(
        value[..., :n, :n], value[..., :n, n:], value[..., n:, :n], value[..., n:, n:]
    )


def value_at(model: System, lft: LFT, values: Mapping[str, ArrayLike]) -> Array:
    """Value of an LFT in the deltas of a model; with a leading axis if any value is an array."""
    kinds = {block.name: block.kind for block in lft.blocks if block.kind != "real"}
    physical = values
    if kinds and isinstance(values, Mapping):
        physical = {name: value for name, value in values.items() if name not in kinds}
    points = deltas_of(model, physical)
    single = all(np.ndim(value) == 0 for value in physical.values())
    if not kinds:
        by_program = value_by_program(model, lft, values, points)
        if by_program is not None:
            return by_program
        if not model.is_proved_regular:
            check_regular_at(lft, points, model.parameters, f"model {model.name!r}")
        found = with_digits(lft, points, evaluate_at(lft, points))
        return found[0] if single else found
    others = {name: value for name, value in values.items() if name in kinds}
    named = {
        p.name: points[0, k] if single else points[:, k] for k, p in enumerate(model.parameters)
    }
    return evaluate(lft, {**named, **others})
