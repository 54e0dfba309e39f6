"""Signals: one named scalar channel of a model."""

from dataclasses import dataclass
from typing import NamedTuple


@dataclass(frozen=True, slots=True)
class Signal:
    """One scalar channel, such as ``shoulder.torque`` in ``N m``."""

    name: str
    unit: str


class Freedom(NamedTuple):
    """Names of one coordinate: what it adds to the labels of quantities, its effort and its measures."""

    label: str
    effort: Signal
    measures: tuple[Signal, Signal, Signal]
    turns: bool
