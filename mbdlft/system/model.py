"""Systems and certified models: linear, with named signals, their parameters left in. numpy only.

xdot = A   x + B_w  w + B_u  u
z    = C_z x + D_zw w + D_zu u
y    = C_y x + D_yw w + D_yu u,      w = Delta z,   Delta = diag(delta_k I_rk, ...),   -1 <= delta_k <= 1
"""

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, Self, SupportsIndex, overload

from mbdlft.base.array import Array
from mbdlft.base.display import heading, table
from mbdlft.base.errors import StructureError, unknown_name
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Signal
from mbdlft.lft.lft import LFT
from mbdlft.lft.sampling import ModelProgram

if TYPE_CHECKING:
    from control import StateSpace


OUTSIDE = 1e-9  # of the width of a range: what rounding may leave a value outside


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


class Submatrix:
    """One of the nine matrices above, at delta = 0: rows xdot, z or y, columns x, w or u."""

    def __init__(self, rows: str, columns: str) -> None:
        self.rows, self.columns = rows, columns
        self.__doc__ = f"(n{rows}, n{columns}), at delta = 0.".replace("nz", "nw")

    @overload
    def __get__(self, system: None, kind: type) -> Self: ...
    @overload
    def __get__(self, system: "System", kind: type) -> Array: ...
    def __get__(self, system: "System | None", kind: type) -> Self | Array:
        if system is None:
            return self
        a, x = system.lft, len(system.states)
        two = {"x": slice(x), "y": slice(x, None), "u": slice(x, None)}
        if self.rows == "z":
            return a.M11 if self.columns == "w" else a.M12[:, two[self.columns]]
        matrix = a.M21 if self.columns == "w" else a.M22[:, two[self.columns]]
        return matrix[two[self.rows]]


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
        kinds = (("states", self.states), ("inputs", self.inputs), ("outputs", self.outputs))
        sizes = ", ".join(f"{len(signals)} {what}" for what, signals in kinds)
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

    A = Submatrix("x", "x")
    B_w = Submatrix("x", "w")
    B_u = Submatrix("x", "u")
    C_z = Submatrix("z", "x")
    D_zw = Submatrix("z", "w")
    D_zu = Submatrix("z", "u")
    C_y = Submatrix("y", "x")
    D_yw = Submatrix("y", "w")
    D_yu = Submatrix("y", "u")

    def __getitem__(self, key: Any) -> "System":
        return _operation("selected", self, key)

    def __neg__(self) -> "System":
        return -1.0 * self

    def __add__(self, other: Any) -> "System":
        return _operation("combine", self, other)

    def __radd__(self, other: Any) -> "System":
        return _operation("combine", other, self)

    def __sub__(self, other: Any) -> "System":
        return _operation("combine", self, other, -1.0)

    def __rsub__(self, other: Any) -> "System":
        return _operation("combine", other, self, -1.0)

    def __mul__(self, other: Any) -> "System":
        return _operation("chain", [other, self])

    def __rmul__(self, other: Any) -> "System":
        return _operation("chain", [self, other])

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
        changed: Self = _above("blocks").with_ranges(self, _by_name(self, ranges, named))
        return changed

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
        numeric: StateSpace = _above("sampled").state_space_at(self, _by_name(self, values, named))
        return numeric


def _by_name(model: System, values: Mapping[str, Any] | None, named: dict[str, Any]) -> dict[str, Any]:
    """Values from a mapping and from keywords, together."""
    if not isinstance(values, Mapping | None):
        example = {(model.parameters.names or ("m",))[0]: 1.0}
        raise StructureError(
            f"model {model.name!r}: expected values by name, such as {example}, got {values!r}."
        )
    return {**(values or {}), **named}


def _above(module: str) -> Any:
    """A module that stands on this one, imported when a method is called.

    Most need scipy, and reading an archive does not.
    """
    return import_module(f"mbdlft.system.{module}")


def _operation(name: str, *operands: Any) -> System:
    made: System = getattr(_above("algebra"), name)(*operands)
    return made


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
    accelerations : tuple of int
        Outputs that are sums of derivatives of states that are derivatives of others, and so
        accelerations of positions: decided on residues, at random values of the parameters. Also those
        of systems that such outputs alone drive.
    driven : tuple of int
        The states of these systems.
    beside : tuple of int
        States of all systems that are no structure, such as filters: of a whole with `accelerations` or
        rigid motions. A state that is the rate of another one there is none of a place.
    momenta : tuple of int
        Of a structure that is free, for each input, how many momenta it has if the input, as springs and
        dampers do, leaves all of them as they are; otherwise 0. Empty for a structure of which no input
        does, and for what is held. Of a whole: those of its free parts together.
    rigid_motions : tuple of int
        Of a structure that is free, if springs and dampers see none of its motions as a rigid body, nor
        their rates: for each output how many it has, and less than 0 if the output sees any. Otherwise
        empty.
    unmoved : tuple of (output, input)
        Of a structure that is free, with `momenta` and `rigid_motions`: outputs that feel nothing of the
        rigid motion that an input causes, as a place across a force; one of `accelerations` nothing of
        its acceleration, either. Inputs that leave the momenta are not listed.
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
        How much larger relative rounding of the data is in an entry of A, B, C, D at a check point:
        2.2e-16 times this is what no computation in double precision sees, and may be more than
        `max_relative_error`. An entry that changes its sign is relative to its largest size over the
        points, others to themselves. At least what rounding of the numbers of the model changes, as its
        channels may cancel, relative to the largest size of an entry. 0.0: not recorded.
    rounding_ratio : float
        Largest error of an entry of A, B, C, D, of the trim, of transfer functions, and of what states
        that are left out would change, in units of 2.2e-16 times the size of its terms: those of the
        data or of the model, whichever are larger. More than 100 is refused when a model is made. Of a
        model that is made of others: the largest of theirs and of its own, which is the difference from
        state-space formulas. 0.0: not recorded, or nothing differs.
    sign_changes : int
        Number of entries that change their sign between the check points, or vanish at some. Near their
        zeros the digits of such entries are those of their largest size over the points.
    order_bound : int
        Proved minimum of the sum of all repetitions. Pairs of parameters that cannot both have their
        lower bound make it larger than the sum of these, which stands for 0.
    well_posed : str
        "proved": the model is regular at every value in the ranges; "sampled": at the check points.
    open_boxes : tuple of boxes
        Where that proof is open: for each box the lowest and the highest physical value of every
        parameter, in their order. Empty if it is proved, or if no proof was tried.
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
    rounding_ratio: float = 0.0
    accelerations: tuple[int, ...] = ()
    momenta: tuple[int, ...] = ()
    rigid_motions: tuple[int, ...] = ()
    unmoved: tuple[tuple[int, int], ...] = ()
    driven: tuple[int, ...] = ()
    beside: tuple[int, ...] = ()

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

    def __post_init__(self) -> None:
        System.__post_init__(self)
        c = self.certificate
        if c.accelerations or c.momenta or c.rigid_motions or c.unmoved or c.driven:
            _above("claims").check_claims(self)

    def _repr_html_(self) -> str:
        c = self.certificate
        said = "minimal: proved" if c.minimal else f"proved to be needed: {c.order_bound}"
        said = said if c.exact else "not exact"
        error = f"largest relative error found: {c.max_relative_error:.1e}"
        return System._repr_html_(self) + heading("", f"order {self.order}, {said}; {error}")

    @property
    def known_program(self) -> ModelProgram | None:
        """Its program; that of a model that this one was made from is not its own."""
        program = self.program
        return program if program is not None and program.is_of(self.lft, self.trim.lft) else None

    @property
    def is_proved_regular(self) -> bool:
        """Whether the certificate says so."""
        return self.certificate.well_posed == "proved"
