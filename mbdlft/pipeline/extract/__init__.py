"""From the instruction tape of linear relations to an LFT; the last place that knows CasADi."""

from mbdlft.pipeline.extract.graph import Extraction as Extraction
from mbdlft.pipeline.extract.graph import SparseExtraction as SparseExtraction
from mbdlft.pipeline.extract.lifting import extract as extract
from mbdlft.pipeline.extract.lifting import extract_within as extract_within
