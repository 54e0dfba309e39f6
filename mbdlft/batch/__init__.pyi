from .compiled import Compiled as Compiled
from .compiled import Linearizations as Linearizations
from .compiled import compile as compile
from .run import SweepReport as SweepReport
from .run import sweep as sweep
from .samples import GridSamples as GridSamples
from .samples import RandomSamples as RandomSamples
from .samples import read_samples as read_samples
