"""From the instruction tape of linear relations to an LFT; the last place that knows CasADi."""

from mbdlft.extract.tape import Extraction as Extraction
from mbdlft.extract.tape import extract as extract
