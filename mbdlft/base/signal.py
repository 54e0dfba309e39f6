"""Signals: the named scalar inputs, outputs and states of a model."""

from dataclasses import dataclass
from typing import NamedTuple


@dataclass(frozen=True, slots=True)
class Signal:
    """A scalar input, output or state, such as ``shoulder.torque`` in ``N m``."""

    name: str
    unit: str


class Freedom(NamedTuple):
    """Names of one coordinate of a joint or an elastic body.

    Attributes
    ----------
    label : the ending of labels of quantities, such as ``x`` of ``stiffness.x``; empty if there is one
    only effort : its generalized force measures : its displacement, velocity and acceleration turns :
    whether it is an angle
    """

    label: str
    effort: Signal
    measures: tuple[Signal, Signal, Signal]
    turns: bool
