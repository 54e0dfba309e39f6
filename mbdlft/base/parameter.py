"""Parameters of a model: name, unit, nominal value, range, role, and the map physical <-> delta.

A physical value is mapped to an *internal* value, in which the equations are rational, and the internal
value to a normalized delta:

    internal = physical                            identity
    internal = tan((physical - reference) / 2)     half-angle
    internal = tan((physical - reference) / 4)     quarter-angle
    internal = (b0 + b1 delta) / (1 + a1 delta)    delta = -1, 0, 1 at low, nominal, high
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import ArrayLike
from mbdlft.base.display import table
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import ANGLE_UNITS, parse_unit

Role = Literal["uncertain", "scheduled", "design", "nonlinear"]
Substitution = Literal["identity", "half-angle", "quarter-angle"]

ROLES: tuple[str, ...] = get_args(Role)[:3]  # of parameters that somebody declares
SUBSTITUTIONS: tuple[str, ...] = get_args(Substitution)
# least distance of the nominal value from either bound, of the width of the range: half of 16 digits stay
_NEAREST = 1e-8
# least distance from a singular point, of the reach: the tangent is then up to 1e5, and 11 digits stay
_NEAREST_SINGULAR = 1e-5
# the internal value is the tangent of the angle divided by this
DIVISORS = {"identity": 1.0, "half-angle": 2.0, "quarter-angle": 4.0}


@dataclass(frozen=True, slots=True)
class BilinearMap:
    """The map internal = b0 + gain delta / (1 + a1 delta) = (b0 + b1 delta) / (1 + a1 delta)."""

    b0: float
    gain: float
    a1: float

    @property
    def b1(self) -> float:
        """Coefficient of delta in the numerator."""
        return self.gain + self.a1 * self.b0


@dataclass(frozen=True, slots=True, init=False)
class Parameter:
    """A named quantity that stays in the model.

    Parameters
    ----------
    name : str
        Letters, digits and underscores. Parameters of the same name are the same parameter.
    nominal : float
        Value at delta = 0, in `unit`.
    low, high : float, optional
        Values at delta = -1 and +1, in `unit`; `nominal` is strictly between them.
    percent : float, optional
        Half width of the range in percent of the nominal value, instead of low and high.
    plus, minus : float, optional
        Distances from the nominal value to high and low, in `unit`; `minus` is `plus` if not given.
    unit : str
        Such as ``"kg m^2"``; ``"1"`` if dimensionless.
    role : {"uncertain", "scheduled", "design", "nonlinear"}
        Who chooses the value: nature, the operating point, the engineer; or, at each time, a nonlinear
        function for which it stands (`mbdlft.analyze.with_sectors`).
    substitution : {"identity", "half-angle", "quarter-angle"}
        The map to the internal value; `Angle` chooses it for angles.
    reference : float
        The angle (rad) at which the internal value of an angle is zero.
    """

    name: str
    nominal: float
    low: float
    high: float
    unit: str
    role: Role
    substitution: Substitution
    reference: float

    def __init__(
        self,
        name: str,
        nominal: float,
        low: float | None = None,
        high: float | None = None,
        *,
        percent: float | None = None,
        plus: float | None = None,
        minus: float | None = None,
        unit: str = "1",
        role: Role = "uncertain",
        substitution: Substitution = "identity",
        reference: float = 0.0,
    ) -> None:
        where = f"parameter {name!r}"
        texts = {"name": name, "unit": unit, "role": role, "substitution": substitution}
        for label, text in texts.items():
            if not isinstance(text, str):
                raise SceneError(f"{where}: {label}: expected a text, got {text!r}.")
        ends = {"low": low, "high": high, "percent": percent, "plus": plus, "minus": minus}
        _check_number(where, "nominal", nominal)
        for label, value in {**ends, "reference": reference}.items():
            if value is not None:
                _check_number(where, label, value)
        low, high = _range(where, nominal, **ends)
        sizes = {"nominal": float(nominal), "low": low, "high": high, "reference": float(reference)}
        for field, entry in (*texts.items(), *sizes.items()):
            object.__setattr__(self, field, entry)
        problem = _problem(self)
        if problem:
            raise SceneError(f"{where}: {problem}")

    def _repr_html_(self) -> str:
        names = ("parameter", "nominal", "low", "high", "unit", "role")
        return table(names, [(self.name, *(getattr(self, name) for name in names[1:]))])

    @property
    def is_angle(self) -> bool:
        """Whether this is an angle, whose internal value is the tangent of a part of it."""
        return self.substitution != "identity"

    @property
    def factor(self) -> float:
        """Its unit in SI units, or in rad: what a value is multiplied with."""
        return parse_unit(self.unit).factor

    @property
    def map(self) -> BilinearMap:
        """The bilinear map between delta and the internal value."""
        low, nominal, high = (float(x) for x in to_internal(self, [self.low, self.nominal, self.high]))
        excess = 2.0 * nominal - low - high
        if abs(excess) <= 4.0 * np.finfo(float).eps * max(abs(low), abs(nominal), abs(high)):
            return BilinearMap(nominal, 0.5 * (high - low), 0.0)  # centered: affine
        gain = 2.0 * (high - nominal) * (nominal - low) / (high - low)
        return BilinearMap(nominal, gain, excess / (high - low))


def Angle(
    name: str,
    nominal: float,
    low: float | None = None,
    high: float | None = None,
    *,
    plus: float | None = None,
    minus: float | None = None,
    unit: str = "deg",
    role: Role = "scheduled",
    substitution: Substitution = "half-angle",
    reference: float | None = None,
) -> Parameter:
    """Make a parameter that is an angle, such as the equilibrium position of a revolute joint.

    Parameters
    ----------
    name, nominal, low, high, plus, minus, role
        As for `Parameter`; angles are in `unit`.
    unit : {"deg", "rad"}
    substitution : {"half-angle", "quarter-angle"}
        With the half-angle, each rotation of a vector in a plane needs 2 repetitions, and the range ends
        less than 180 deg to either side of the reference. With the quarter-angle, it needs 4, and the
        range ends less than 360 deg to either side.
    reference : float, optional
        The angle at which the internal value is zero, in `unit`; by default the nominal value. Zero gives
        ``tan(theta/2)``, as in Kassarian et al. 2023.

    Raises
    ------
    SceneError
        `Parameter` raises it, or the range reaches a singular point of the substitution.
    """
    where = f"parameter {name!r}"
    if not isinstance(unit, str) or unit not in ANGLE_UNITS:
        raise SceneError(f"{where}: an angle has unit 'deg' or 'rad', got {unit!r}.")
    if not isinstance(substitution, str) or substitution not in SUBSTITUTIONS[1:]:
        raise SceneError(
            f"{where}: substitution of an angle is 'half-angle' or 'quarter-angle', got {substitution!r}."
        )
    label, center = ("nominal", nominal) if reference is None else ("reference", reference)
    _check_number(where, label, center)
    return Parameter(
        name,
        nominal,
        low,
        high,
        plus=plus,
        minus=minus,
        unit=unit,
        role=role,
        substitution=substitution,
        reference=float(center) * parse_unit(unit).factor,
    )


def to_internal(parameter: Parameter, physical: ArrayLike) -> NDArray[np.float64]:
    """Internal values of physical values in `parameter.unit`, elementwise; the shape stays."""
    values = np.asarray(physical, dtype=float)
    if not parameter.is_angle:
        return values
    radians = values * parameter.factor
    return np.tan((radians - parameter.reference) / DIVISORS[parameter.substitution])


def internal_slope(parameter: Parameter, internal: float) -> float:
    """The derivative of the internal value by the physical one, where the internal one is given."""
    if not parameter.is_angle:
        return 1.0
    factor = parameter.factor / DIVISORS[parameter.substitution]
    return factor * (1.0 + internal * internal)


def cosine_sine_parts(substitution: Substitution, t: Any) -> tuple[Any, Any, Any]:
    """Numerators of the cosine and the sine of the angle from the reference, and their denominator.

    With the tangent t of half of the angle, cos = (1 - t^2)/(1 + t^2), sin = 2 t/(1 + t^2). With the
    tangent of a quarter of the angle, these formulas are applied twice. `t` may be of any number system.
    """
    square = t * t
    if substitution == "half-angle":
        return 1 - square, 2 * t, 1 + square
    return 1 - 6 * square + square * square, 4 * t * (1 - square), (1 + square) * (1 + square)


@arguments_checked
def to_delta(parameter: Parameter, physical: ArrayLike) -> NDArray[np.float64]:
    """Normalized deltas of physical values, elementwise.

    Parameters
    ----------
    parameter : Parameter
    physical : number or array of any shape, in `parameter.unit`

    Returns
    -------
    array of the same shape [1]; -1, 0, 1 at low, nominal, high
    """
    return _delta(parameter, physical)


def _delta(parameter: Parameter, physical: ArrayLike) -> NDArray[np.float64]:
    internal, m = to_internal(parameter, physical), parameter.map
    distance = internal - m.b0
    return distance / (m.gain - m.a1 * distance)


def deltas_at(parameters: Sequence[Parameter], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Deltas (N, n_p) [1] of physical points (N, n_p)."""
    columns = [_delta(p, points[:, k]) for k, p in enumerate(parameters)]
    return np.stack(columns, axis=1) if columns else points


@arguments_checked
def to_physical(parameter: Parameter, delta: ArrayLike) -> NDArray[np.float64]:
    """Physical values of normalized deltas, elementwise; the inverse of `to_delta`.

    Parameters
    ----------
    parameter : Parameter
    delta : number or array of any shape [1]

    Returns
    -------
    array of the same shape, in `parameter.unit`; infinite at the delta that no value has
    """
    values, m = np.asarray(delta, dtype=float), parameter.map
    with np.errstate(divide="ignore"):
        internal = m.b0 + m.gain * values / (1.0 + m.a1 * values)
    if not parameter.is_angle:
        return internal
    radians = parameter.reference + DIVISORS[parameter.substitution] * np.arctan(internal)
    return radians / parameter.factor


def is_finite(value: object) -> bool:
    """Whether this is a number that is finite also when it is converted to a float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer of hundreds of digits
        return False


def _check_number(where: str, label: str, value: object) -> None:
    """Raise a SceneError unless this is a number; nan and inf pass, as `_problem` names them."""
    if not (isinstance(value, float) or is_finite(value)):
        raise SceneError(f"{where}: {label}: expected a number, got {value!r}.")


def _range(
    where: str,
    nominal: float,
    low: float | None,
    high: float | None,
    percent: float | None,
    plus: float | None,
    minus: float | None,
) -> tuple[float, float]:
    """Low and high of a range that is given in exactly one of three ways."""
    ways = sum(any(end is not None for end in way) for way in ((low, high), (percent,), (plus, minus)))
    if ways != 1:
        raise SceneError(
            f"{where}: give the range in exactly one way: low and high, percent, or plus "
            f"(and minus); got {ways} of them."
        )
    if percent is not None:
        if nominal == 0 or percent <= 0:
            raise SceneError(
                f"{where}: {percent:g} percent of the nominal {nominal:g} is not a range. Give a "
                "positive percent of a nominal that is not zero, or low and high."
            )
        plus = abs(nominal) * percent / 100.0
    if plus is not None:
        return float(nominal - (plus if minus is None else minus)), float(nominal + plus)
    if minus is not None:
        raise SceneError(f"{where}: minus is given without plus.")
    if low is None or high is None:
        raise SceneError(f"{where}: {'low' if low is None else 'high'} is missing.")
    return float(low), float(high)


def _problem(parameter: Parameter) -> str | None:
    """A sentence on what is wrong with a parameter, or None."""
    p = parameter
    if not p.name.isidentifier():
        return "a name is made of letters, digits and underscores and does not start with a digit."
    if p.role not in get_args(Role):
        return f"role is one of {', '.join(ROLES)}; got {p.role!r}."
    if p.substitution not in SUBSTITUTIONS:
        return f"substitution is one of {', '.join(SUBSTITUTIONS)}; got {p.substitution!r}."
    try:
        factor = p.factor
    except SceneError as error:
        return str(error)
    if not p.is_angle and p.unit in ANGLE_UNITS:
        return f"a parameter in {p.unit} is an angle; declare it as an Angle."
    if p.is_angle and p.unit not in ANGLE_UNITS:
        return f"the {p.substitution} needs unit 'deg' or 'rad', got {p.unit!r}."
    if not np.all(np.isfinite([p.nominal, p.low, p.high, p.reference])):
        said = f"nominal {p.nominal}, low {p.low}, high {p.high}"
        return f"values must be finite, got {said}{f', reference {p.reference}' * p.is_angle}."
    if p.low >= p.high:
        low, high = (f"{x} {p.unit}".removesuffix(" 1") for x in (p.low, p.high))
        return f"low must be less than high, got low = {low}, high = {high}."
    if not p.low < p.nominal < p.high:
        return (
            f"the nominal must lie strictly inside the range, got nominal = {p.nominal}, "
            f"range [{p.low}, {p.high}] {p.unit}."
        )
    if min(p.nominal - p.low, p.high - p.nominal) < _NEAREST * (p.high - p.low):
        return (
            f"the nominal {p.nominal:g} is too close to an end of the range [{p.low:g}, {p.high:g}] "
            f"{p.unit}: the other end would be mapped with a loss of digits. Move the nominal."
        )
    if p.is_angle:
        reach = np.pi * DIVISORS[p.substitution] / 2.0
        farthest = max(abs(p.low * factor - p.reference), abs(p.high * factor - p.reference))
        if farthest >= reach * (1.0 - _NEAREST_SINGULAR):
            center = p.reference / factor
            advice = "Move the reference or narrow the range."
            if p.substitution == "half-angle" and farthest < 2.0 * np.pi * (1.0 - 1e-12):
                advice = "Use substitution = 'quarter-angle'."
            if p.unit == "rad" and max(abs(p.low), abs(p.high)) > 4.0 * np.pi:
                advice = "If these are degrees, give unit = 'deg'."
            return (
                f"the range [{p.low}, {p.high}] {p.unit} reaches a singular point of the "
                f"{p.substitution} at {center - reach / factor:g} or {center + reach / factor:g} "
                f"{p.unit}. {advice}"
            )
    return None


def exact_cosine_sine(angle: float) -> tuple[float, float]:
    """Cosine and sine of an angle (rad); exactly 0 and 1 at the multiples of a right angle."""
    quarter = angle / (np.pi / 2.0)
    nearest = round(quarter)
    if abs(quarter - nearest) <= 4.0 * np.finfo(float).eps * max(1.0, abs(quarter)):
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[nearest % 4]
    return float(np.cos(angle)), float(np.sin(angle))


def at_values(parameters: Iterable[Parameter], values: Iterable[float]) -> str:
    """Values of all parameters, with their units, for messages."""
    return ", ".join(
        f"{p.name} = {value:.6g} {p.unit}".removesuffix(" 1")
        for p, value in zip(parameters, values, strict=True)
    )
