"""Sweeps: trims and linearizations at millions of samples, into an archive."""

from mbdlft.batch.run import SweepReport as SweepReport
from mbdlft.batch.run import sweep as sweep
from mbdlft.batch.samples import GridSamples as GridSamples
from mbdlft.batch.samples import RandomSamples as RandomSamples
from mbdlft.batch.samples import read_samples as read_samples
