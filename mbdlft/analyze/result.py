"""The arguments that analyses have in common, and the type of their results."""

from collections.abc import Callable

from mbdlft.base.errors import AnalysisError
from mbdlft.bound.evidence import Bounds as Bounds
from mbdlft.bound.evidence import BoxProof as BoxProof
from mbdlft.bound.evidence import IntervalProof as IntervalProof
from mbdlft.bound.evidence import MotionProof as MotionProof

UNSTABLE = (
    "the system is unstable at the worst case, a value inside the ranges; robust_stability says how much "
    "of the ranges is stable"
)
GAP, WORK, LARGEST = 0.01, 30.0, 100.0
Progress = Callable[[float, float], None]


def check_numbers(what: str, **numbers: float) -> None:
    """Raise an AnalysisError unless the gap is below 1 and all are positive and finite."""
    for name, value in numbers.items():
        most = 1.0 if name == "gap" else float("inf")
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < most:
            raise AnalysisError(
                f"{what}: {name}: expected a number between 0 and {most:g}, got {value!r}."
            )
