"""Goals of a tuner: what is asked of the closed loop, each as a ratio that is to be at most 1.

    gain          |W_out T W_in| / limit in the H-infinity norm, or in the H2 norm
    margin        alpha |S - 1/2|, S the sensitivity where the loop is opened: a disk margin of alpha
    poles         decay / -Re(lambda),   damping |lambda| / -Re(lambda),   |lambda| / speed
    design        f(design parameters) / limit

A template of a response over frequency is the inverse of a weight, which is a system. Three
templates have goals of their own, w_c = 2/(time of the response), k = 100 and e = w_0/1000:

    tracking      W = (s + w_c)/(peak s + w_c dc)                  of reference to error
    roll-off      W = ((s/w_0)/(s/(k w_0) + 1))^n                  of what has to fall beyond w_0
    acceleration  W = (s^2 + 2 xi w_0 s + w_0^2)/(s^2 + r e s + e^2), r^2 = 2   of disturbing to true one

The last one is the second-order template on the acceleration sensitivity (SOTAS) of Perez, thesis, 2016,
chapter 8, with its double integrator moved to the left by e. The disk margin is that of Seiler, Packard,
Gahinet (IEEE Control Systems Magazine 40, 2020) without skew.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.response.modes import spectrum
from mbdlft.synthesis.pieces import Names, check_positive, listed, tunable_gain, tunable_transfer
from mbdlft.system.algebra import chain
from mbdlft.system.conversion import as_system, state_space
from mbdlft.system.model import System

HINF, H2, MARGIN, POLES, DESIGN = "H-infinity", "H2", "disk margin", "poles", "design"
_PROPER = 100.0  # times the frequency of a roll-off, where its weight ends
_LEAK = 1e-3  # of the frequency of a mode: what its double integrator is moved by


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """What is asked of a loop: its value is at most 1 where the goal is reached.

    Attributes
    ----------
    kind : ``"H-infinity"``, ``"H2"``, ``"disk margin"``, ``"poles"`` or ``"design"``
    name : str
    inputs, outputs : tuple of str
        Channels of the closed loop.
    limit : float
        Of a norm: that is not to be passed, in the unit of the channels and weights.
    hard : bool
        A hard goal is a constraint; the largest of the others is made small.
    before, after : System, or None
        Weights at the inputs and at the outputs.
    decay, damping, speed : float
        Of poles: at least, at least, and at most (rad/s, 1, rad/s).
    expression : str
        Of design parameters, in their units.
    """

    kind: str
    name: str
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    _: KW_ONLY
    limit: float = 1.0
    hard: bool = False
    before: System | None = None
    after: System | None = None
    decay: float = 0.0
    damping: float = 0.0
    speed: float = np.inf
    expression: str = ""

    def __post_init__(self) -> None:
        if self.kind in (HINF, H2, MARGIN) and not (self.inputs and self.outputs):
            raise StructureError(f"goal {self.name!r}: expected one channel or more at each end.")


def gain_goal(
    inputs: Names,
    outputs: Names,
    *,
    limit: float = 1.0,
    before: Any = None,
    after: Any = None,
    norm: str = HINF,
    hard: bool = False,
    name: str = "",
) -> Goal:
    """A limit of the weighted gain between channels: its H-infinity or H2 norm.

    Parameters
    ----------
    inputs, outputs : name, or sequence of names
        Channels as `connect` takes them: inputs of systems, to which these are added, or new names that
        stand in the connections; outputs of systems, or inputs of systems, which are what adds up there.
    limit : float
    before, after : System, python-control system, number or matrix, optional
        Stable weights at the inputs and at the outputs; one with one channel stands at each of them.
    norm : {"H-infinity", "H2"}
    hard : bool
        Whether it is a constraint.
    name : str, optional
        By default the channels.
    """
    u, y = tuple(listed(inputs)), tuple(listed(outputs))
    name = name or f"{', '.join(u)} to {', '.join(y)}"
    if norm not in (HINF, H2):
        raise StructureError(f"goal {name!r}: expected the norm {HINF!r} or {H2!r}, got {norm!r}.")
    check_positive(f"goal {name!r}", limit=limit)
    first, last = _weight(before, len(u), name), _weight(after, len(y), name)
    return Goal(norm, name, u, y, limit=limit, hard=hard, before=first, after=last)


def tracking_goal(
    references: Names,
    errors: Names,
    *,
    time: float,
    dc: float = 1e-3,
    peak: float = 1.3,
    hard: bool = False,
    name: str = "",
) -> Goal:
    """Errors that follow a reference: small up to 2/time, and never above a peak.

    Parameters
    ----------
    references, errors : name, or sequence of as many names
        Channels as for `gain_goal`.
    time : float, in s
        Of the response.
    dc : float
        Part of the reference that may be left at low frequency.
    peak : float, above 1
        Of the error at any frequency.
    hard, name
        As for `gain_goal`.
    """
    name = name or f"tracking of {', '.join(listed(references))}"
    check_positive(f"goal {name!r}", time=time, dc=dc, peak=peak)
    if not dc < peak:
        raise StructureError(f"goal {name!r}: expected a peak above dc = {dc!r}, got {peak!r}.")
    w = 2.0 / time
    weight = rational("tracking", np.array([1.0, w]), np.array([peak, w * dc]))
    return gain_goal(references, errors, after=weight, hard=hard, name=name)


def rolloff_goal(
    inputs: Names,
    outputs: Names,
    *,
    frequency: float,
    slope: int = 1,
    limit: float = 1.0,
    hard: bool = False,
    name: str = "",
) -> Goal:
    """A gain that falls beyond a frequency, by 20 dB a decade and slope.

    Parameters
    ----------
    inputs, outputs : name, or sequence of names
        Channels as for `gain_goal`.
    frequency : float, in rad/s
        At which the asymptote is the limit.
    slope : int
        1 for 20 dB a decade, 2 for 40; up to 100 times the frequency.
    limit, hard, name
        As for `gain_goal`.
    """
    name = name or f"roll-off to {', '.join(listed(outputs))}"
    check_positive(f"goal {name!r}", frequency=frequency, slope=slope)
    if not isinstance(slope, int):
        raise StructureError(f"goal {name!r}: expected a whole slope, such as 2, got {slope!r}.")
    end = _PROPER * frequency
    lag = rational("lag", np.array([_PROPER, 0.0]), np.array([1.0, end]))
    weight = chain([lag] * slope) if slope > 1 else lag
    return gain_goal(inputs, outputs, after=weight, limit=limit, hard=hard, name=name)


def acceleration_goal(
    disturbances: Names,
    accelerations: Names,
    *,
    frequency: float,
    damping: float,
    limit: float = 1.0,
    hard: bool = False,
    name: str = "",
) -> Goal:
    """Accelerations by disturbing ones as of a mode with this frequency and damping, or smaller.

    Parameters
    ----------
    disturbances, accelerations : name, or sequence of as many names
        What is added to an acceleration, or a force over its mass, and the acceleration.
    frequency : float, in rad/s
    damping : float
    limit : float
        Times those of the mode; with two channels that are the same the norm is 1 at least.
    hard, name
        As for `gain_goal`.
    """
    name = name or f"acceleration of {', '.join(listed(accelerations))}"
    check_positive(f"goal {name!r}", frequency=frequency, damping=damping)
    leak = frequency * _LEAK
    mode = np.array([1.0, 2.0 * damping * frequency, frequency**2])
    weight = rational("mode", mode, np.array([1.0, 2.0**0.5 * leak, leak**2]))
    return gain_goal(disturbances, accelerations, after=weight, limit=limit, hard=hard, name=name)


def rational(name: str, numerator: Array, denominator: Array) -> System:
    """A transfer function of its coefficients, the highest power first."""
    n = len(denominator) - 1
    above = np.concatenate([np.zeros(n + 1 - len(numerator)), numerator])
    b, a = above[::-1] / denominator[0], denominator[::-1] / denominator[0]
    if not n:
        return tunable_gain(name, "u", "y", initial={"D[1,1]": float(b[0])}).with_values({})
    values = {f"{name}.a{k}": float(a[k]) for k in range(n)}
    values |= {f"{name}.b{k}": float(b[k]) for k in range(n + 1)}
    return tunable_transfer(name, "u", "y", n).with_values(values)


def margin_goal(
    channels: Names,
    margin: float = 0.0,
    *,
    gain: float = 0.0,
    phase: float = 0.0,
    hard: bool = False,
    name: str = "",
) -> Goal:
    """A disk margin of the loop that is opened at inputs of systems, all at once.

    Parameters
    ----------
    channels : name, or sequence of names, of inputs of systems
    margin : float, between 0 and 2
        A margin of alpha is one of gain from (2 - alpha)/(2 + alpha) to its inverse, and one of phase of
        2 arctan(alpha/2).
    gain, phase : float, in dB and deg
        Margins that the disk has to have, besides or in place of `margin`.
    hard, name
        As for `gain_goal`.
    """
    u = tuple(listed(channels))
    name = name or f"margin at {', '.join(u)}"
    if not (0.0 <= gain < np.inf and 0.0 <= phase < 90.0):
        raise StructureError(
            f"goal {name!r}: expected a gain margin (dB) from 0 up and a phase margin from 0 to 90 deg, "
            f"got {gain!r} and {phase!r}."
        )
    factor = 10.0 ** (gain / 20.0)
    of_gain, of_phase = 2.0 * (factor - 1.0) / (factor + 1.0), 2.0 * np.tan(np.radians(phase) / 2.0)
    largest = max(margin, of_gain, float(of_phase)) if margin >= 0.0 else margin
    if not 0.0 < largest < 2.0:
        raise StructureError(f"goal {name!r}: expected a disk margin between 0 and 2, got {largest!r}.")
    return Goal(MARGIN, name, u, u, limit=1.0 / largest, hard=hard)


def pole_goal(
    *,
    decay: float = 0.0,
    damping: float = 0.0,
    speed: float = np.inf,
    hard: bool = True,
    name: str = "poles",
) -> Goal:
    """A region of the poles that the free values move.

    Parameters
    ----------
    decay : float, in rad/s
        Real parts are at most its negative.
    damping : float, below 1
        Damping ratios are at least this.
    speed : float, in rad/s
        No pole is farther from zero.
    hard, name
        As for `gain_goal`.
    """
    if not (0.0 <= decay < np.inf and 0.0 <= damping < 1.0 and speed > 0.0) or (
        decay == damping == 0.0 and speed == np.inf
    ):
        raise StructureError(
            f"goal {name!r}: expected a decay from 0 up, a damping from 0 to 1 and a positive speed, one "
            f"of them at least, got {decay!r}, {damping!r}, {speed!r}."
        )
    return Goal(POLES, name, hard=hard, decay=decay, damping=damping, speed=speed)


def design_goal(expression: str, limit: float, *, hard: bool = False, name: str = "") -> Goal:
    """A limit of an expression of design parameters: a mass budget, or a length that is to be large.

    Parameters
    ----------
    expression : str
        Rational in parameters of the role ``design``, in their units, such as ``"M1 + M2"`` to be small,
        or ``"2.3/M1"`` for an M1 that is to be large.
    limit : float
    hard, name
        As for `gain_goal`.

    Returns
    -------
    Goal
    """
    name = name or expression
    check_positive(f"goal {name!r}", limit=limit)
    return Goal(DESIGN, name, limit=limit, hard=hard, expression=expression)


def _weight(weight: Any, channels: int, name: str) -> System | None:
    """A weight of as many channels; one of a single channel stands at each."""
    if weight is None:
        return None
    made = as_system(weight)
    sizes = len(made.inputs), len(made.outputs)
    if sizes == (1, 1) and channels > 1:
        repeated = (np.kron(np.eye(channels), M) for M in (made.A, made.B_u, made.C_y, made.D_yu))
        made, sizes = state_space(*repeated, name=made.name), (channels, channels)
    if channels not in sizes:
        raise StructureError(
            f"goal {name!r}: a weight has {sizes[0]} inputs and {sizes[1]} outputs, expected 1 or "
            f"{channels} of the channels."
        )
    if made.parameters:
        raise StructureError(f"goal {name!r}: a weight has parameters, expected numbers.")
    if len(made.states) and spectrum(made.A).stability != "stable":
        raise StructureError(
            f"goal {name!r}: a weight has the pole {spectrum(made.A).worst:.4g}, expected a stable one. "
            "Move a pole at 0 to the left, such as from 1/s to 1/(s + 0.001)."
        )
    return made


def check_goals(goals: Sequence[Goal]) -> None:
    """Raise an error unless there is a goal, and each is one, of a name of its own."""
    names = [goal.name for goal in goals]
    if not goals:
        raise StructureError("tune: expected one goal or more: what is to be small?")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise StructureError(f"tune: two goals have the name {twice!r}. Name one with name=...")
