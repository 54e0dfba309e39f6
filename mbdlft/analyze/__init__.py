"""What a finished model says: samples of its parameters, and responses."""

from mbdlft.analyze.response import frequency_response as frequency_response
from mbdlft.analyze.response import singular_values as singular_values
from mbdlft.analyze.sample import corners as corners
from mbdlft.analyze.sample import grid as grid
from mbdlft.analyze.sample import random as random
