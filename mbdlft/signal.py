"""Signals: one named scalar channel of a model."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Signal:
    """One scalar channel, such as ``shoulder.torque`` in ``N m``."""

    name: str
    unit: str
