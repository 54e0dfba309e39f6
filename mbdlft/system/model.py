"""The certified model: a system with the evidence that it is right and small. numpy only."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import StructureError
from mbdlft.base.notebook import heading
from mbdlft.base.signal import Signal
from mbdlft.lft.evaluation import ModelProgram
from mbdlft.lft.lft import LFT
from mbdlft.system.system import System, value_at
from mbdlft.system.system import deltas_of as deltas_of
from mbdlft.system.system import matrices_at as matrices_at


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
        largest of its unit. Of a truncated model: of the exact one it comes from. Of a composed one:
        against its parts, and what their errors make of it.
    transfer_error : float
        Largest error of the transfer functions from inputs to outputs at two or three of the check
        points and all `frequencies`, against equations that were not solved for the derivatives of the
        states first, in 50 digits where double precision does not carry it; relative to the largest of a
        row at that frequency, or to 1e-6 of the row's largest over all of them where that is more. It
        counts what rounding of A, B, C and D does between them.
    frequencies : tuple of float
        Where that was looked at (rad/s); empty: not recorded, or a model without states.
    by_terms : tuple of (row, column)
        Entries of [A B ; C D] that are nothing but rounding of terms that cancel; in
        `max_relative_error` they are relative to these terms.
    near : tuple of str
        Sentences on numbers of the problem that nearly are others, with which the order is smaller, such
        as a component 0.866025 of an axis that may be sqrt(3/4). Nothing is changed.
    exact : bool
        Whether the model is the exact one (no truncation, no fit).
    exact_bound : bool
        Whether the lower bound was computed in exact arithmetic, without rounding.
    doubtful : tuple of int
        Ranks that rounding makes unclear; the lower bound does not count them. Empty: not recorded.
    truncation_error : float
        Guaranteed bound [1] of what truncation changes, over the whole range, as in `truncate`; 0.0 if
        nothing was truncated, inf if a part was and no theorem gives a bound for the whole.
    fit_error_bound : float
        Guaranteed bound of the error of what are rational fits, over the whole range: of positions of a
        scene (rad or m); of a model of equations relative to the size of each quantity, or in the unit of
        a coefficient; 0.0 if nothing was fitted. The other numbers are then those at the fits.
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
    well_posed : str
        "proved": the model is regular at every value in the ranges; "sampled": at the check points.
    open_boxes : tuple of boxes
        Where that proof is open: for each box the lowest and the highest physical value of every
        parameter, in their order. Empty if it is proved, or if no proof was tried.

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
    well_posed: str = "sampled"
    open_boxes: tuple[tuple[tuple[float, float], ...], ...] = ()
    transfer_error: float = 0.0
    frequencies: tuple[float, ...] = ()
    by_terms: tuple[tuple[int, int], ...] = ()
    near: tuple[str, ...] = ()

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
class LFTModel(System):
    """A system with evidence: what holds its equilibrium, what is proved and checked, where it is from.

    Fields are those of `System`, the three below, and the straight-line program of its values, if it is
    known (`with_program`).
    """

    trim: Trim
    certificate: Certificate
    provenance: Provenance
    program: ModelProgram | None = field(default=None, kw_only=True)

    def _repr_html_(self) -> str:
        c = self.certificate
        said = "minimal: proved" if c.minimal else f"proved to be needed: {c.order_bound}"
        said = said if c.exact else "not exact"
        error = f"largest relative error found: {c.max_relative_error:.1e}"
        return System._repr_html_(self) + heading("", f"order {self.order}, {said}; {error}")

    @property
    def known_program(self) -> ModelProgram | None:
        """Its program; that of a model that this one was made from is not its own."""
        found = self.program
        return found if found is not None and found.is_of(self.lft, self.trim.lft) else None

    @property
    def is_proved_regular(self) -> bool:
        """Whether the certificate says so."""
        return self.certificate.well_posed == "proved"


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
    if not isinstance(model, LFTModel):
        raise StructureError(f"model {model.name!r} is a system without evidence, and has no trim.")
    if model.trim.lft is None:
        raise StructureError(f"model {model.name!r} was stored without the LFT of its trim.")
    return value_at(model, model.trim.lft, values)[..., 0]
