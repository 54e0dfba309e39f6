"""Relations in doubles, solved for their unknown signals."""

from dataclasses import dataclass

from mbdlft.lft.lft import LFT, eliminate
from mbdlft.order.reduction_in_doubles import reduce_order


@dataclass(frozen=True, slots=True)
class Closing:
    """How relations are solved for their unknown signals, in doubles.

    Attributes
    ----------
    unknown, derivatives, outputs : int
        Numbers of unknown signals, of the derivatives among them, which come first, and of outputs.
    """

    unknown: int
    derivatives: int
    outputs: int

    def solved(self, opened: LFT) -> LFT:
        """Not reduced."""
        solved = eliminate(opened, self.unknown)
        rows = [*range(self.derivatives), *range(self.unknown, self.unknown + self.outputs)]
        return LFT(solved.M11, solved.M12, solved.M21[rows], solved.M22[rows], solved.blocks)

    def __call__(self, opened: LFT) -> LFT:
        """Reduced."""
        return reduce_order(self.solved(opened))
