"""The LFT model: the waist below the extraction. numpy only; nothing here needs CasADi.

xdot = A   x + B_w  w + B_u  u
z    = C_z x + D_zw w + D_zu u
y    = C_y x + D_yw w + D_yu u,      w = diag(delta_k I_rk) z,  -1 <= delta_k <= 1
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError, unknown_name
from mbdlft.base.parameter import Parameter, to_delta
from mbdlft.base.signal import Signal
from mbdlft.lft.evaluate import evaluate_at
from mbdlft.lft.lft import LFT

if TYPE_CHECKING:
    from control import StateSpace

_OUTSIDE = 1e-9  # of the width of a range: what rounding may leave a value outside


class StateMatrices(NamedTuple):
    """A, B, C, D of one model, or of N with a leading axis; units as those of the signals."""

    A: Array
    B: Array
    C: Array
    D: Array


@dataclass(frozen=True, slots=True)
class Trim:
    """What holds the equilibrium: numbers at nominal, and a static LFT with the constant 1 as input."""

    signals: tuple[Signal, ...]
    nominal: tuple[float, ...]
    lft: LFT | None


@dataclass(frozen=True, slots=True)
class Certificate:
    """What is proved and what was checked; the tuples are by parameter.

    Attributes
    ----------
    order, lower_bound, raw_order : repetitions of the model, their proved minimum, before reduction
        The minimum is that of exact models; a truncated one may be smaller.
    max_relative_error : float
        Against trimming and linearizing the nonlinear equations at `check_points` values of the
        parameters, random points and corners drawn with `seed`; for a matrix, against its value. Each
        entry of A, B, C, D is relative to its largest size over the points, each trimmed effort to the
        largest of its unit. Of a truncated model: of the exact one it comes from.
    exact : bool
        Whether the model is the exact one (no truncation, no fit).
    exact_bound : bool
        Whether the lower bound was computed in exact arithmetic, without rounding.
    doubtful : tuple of int
        Ranks that rounding makes unclear; the lower bound does not count them. Empty: not recorded.
    truncation_error : float
        Guaranteed bound [1] of what truncation changes, over the whole range, as in `truncate`; 0.0 if
        nothing was truncated.
    fit_error_bound : float
        Guaranteed bound (rad or m) of the error of equilibrium positions that are rational fits, over the
        whole range; 0.0 if nothing was fitted. The other numbers are then those at the fitted positions.
    condition : float
        How much larger the relative rounding of the data is in an entry of A, B, C, D at a check point:
        2.2e-16 times this is what no computation in double precision sees, and may be more than
        `max_relative_error`. An entry that changes its sign is relative to its largest size over the
        points, others to themselves. 0.0: not recorded.
    sign_changes : int
        Number of entries that change their sign between the check points, or vanish at some: near there
        they have digits relative to their largest size only.
    order_bound : int
        Proved minimum of the sum of all repetitions. Pairs of parameters that cannot both have their
        lower bound make it larger than the sum of these, which stands for 0.

    Raises
    ------
    StructureError
        `order_bound` is below the sum of the lower bounds.
    """

    order: tuple[int, ...]
    lower_bound: tuple[int, ...]
    raw_order: tuple[int, ...]
    max_relative_error: float
    check_points: int
    seed: int
    exact: bool
    exact_bound: bool = False
    doubtful: tuple[int, ...] = ()
    truncation_error: float = 0.0
    order_bound: int = 0
    fit_error_bound: float = 0.0
    condition: float = 0.0
    sign_changes: int = 0

    def __post_init__(self) -> None:
        alone = sum(self.lower_bound)
        if self.order_bound == 0:
            object.__setattr__(self, "order_bound", alone)
        if self.order_bound < alone:
            raise StructureError(
                f"certificate: order_bound is {self.order_bound}, expected at least {alone}, the sum of "
                "the lower bounds."
            )

    @property
    def gap(self) -> tuple[int, ...]:
        """Repetitions above the lower bound, by parameter."""
        return tuple(a - b for a, b in zip(self.order, self.lower_bound, strict=True))

    @property
    def minimal(self) -> bool:
        """Whether no exact LFT of the same matrix can be smaller: exact, and order = bound."""
        return self.exact and sum(self.order) == self.order_bound


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a model comes from: the text of the scene or matrix, versions, the time (ISO 8601, UTC)."""

    scene: str
    mbdlft: str
    casadi: str
    numpy: str
    h5py: str
    created: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LFTModel:
    """A linear model with its parameters left in: value of `lft` = [A B ; C D].

    Raises
    ------
    StructureError
        The blocks of the LFT are not the parameters, or the shape is not that of the signals.
    """

    name: str
    lft: LFT
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    parameters: tuple[Parameter, ...]
    trim: Trim
    certificate: Certificate
    provenance: Provenance
    description: str = ""

    def __post_init__(self) -> None:
        names = [parameter.name for parameter in self.parameters]
        shape = (len(self.states) + len(self.outputs), len(self.states) + len(self.inputs))
        if [block.name for block in self.lft.blocks] != names:
            raise StructureError(
                f"model {self.name!r}: the blocks {[b.name for b in self.lft.blocks]} are not the "
                f"parameters {names}."
            )
        if self.lft.shape != shape:
            raise StructureError(
                f"model {self.name!r}: the signals need shape {shape}, the LFT has {self.lft.shape}."
            )

    def __repr__(self) -> str:
        parts = (("states", self.states), ("inputs", self.inputs), ("outputs", self.outputs))
        sizes = ", ".join(f"{len(signals)} {what}" for what, signals in parts)
        blocks = ", ".join(f"{name} {size}" for name, size in self.lft.blocks)
        return f"<LFTModel {self.name!r}: {sizes}; order {self.order}: {blocks or 'no parameters'}>"

    @property
    def order(self) -> int:
        """Size of Delta."""
        return self.lft.order

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

    def at(self, **values: float) -> "StateSpace":
        """The model at physical values by name, in their units; the others are nominal.

        Returns
        -------
        control.StateSpace
            With the names of the signals; python-control does not allow dots, so ``shoulder.torque``
            is named ``shoulder_torque``.
        """
        import control  # here because it is slow to import and reading an archive does not need it

        for name, value in values.items():
            if np.ndim(value) != 0:
                raise StructureError(
                    f"model {self.name!r}: at() takes one number for {name}; for arrays use "
                    "matrices_at(model, values)."
                )
        matrices = matrices_at(self, values)
        return control.ss(
            *matrices,
            name=self.name.replace(".", "_"),
            states=[signal.name.replace(".", "_") for signal in self.states],
            inputs=[signal.name.replace(".", "_") for signal in self.inputs],
            outputs=[signal.name.replace(".", "_") for signal in self.outputs],
        )


def deltas_of(model: LFTModel, values: Mapping[str, ArrayLike]) -> Array:
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


def matrices_at(model: LFTModel, values: Mapping[str, ArrayLike]) -> StateMatrices:
    """State matrices at physical values by name.

    Parameters
    ----------
    model : LFTModel
    values : mapping of names to numbers or arrays (N,), in the units of the parameters
        The others are nominal.

    Returns
    -------
    StateMatrices
        A (nx, nx) and so on for numbers; A (N, nx, nx) and so on if any value is an array.

    Raises
    ------
    StructureError
        A name is unknown, a value lies outside its range, or the lengths differ.
    WellPosednessError
        The model is singular at one of the points.
    """
    value = _value_at(model, model.lft, values)
    n = len(model.states)
    return StateMatrices(
        value[..., :n, :n], value[..., :n, n:], value[..., n:, :n], value[..., n:, n:]
    )


def trim_at(model: LFTModel, values: Mapping[str, ArrayLike]) -> Array:
    """Trimmed quantities at physical values by name, from their static LFT.

    Parameters
    ----------
    model : LFTModel
    values : mapping of names to numbers or arrays (N,), in the units of the parameters
        The others are nominal.

    Returns
    -------
    array (n_t,), or (N, n_t) if any value is an array, in the units of `model.trim.signals`

    Raises
    ------
    StructureError
        The model has no trim LFT; or as `matrices_at`.
    """
    if model.trim.lft is None:
        raise StructureError(f"model {model.name!r} was stored without the LFT of its trim.")
    return _value_at(model, model.trim.lft, values)[..., 0]


def _value_at(model: LFTModel, lft: LFT, values: Mapping[str, ArrayLike]) -> Array:
    """Value of an LFT in the deltas of a model; with a leading axis if any value is an array."""
    found = evaluate_at(lft, deltas_of(model, values))
    return found[0] if all(np.ndim(array) == 0 for array in values.values()) else found
