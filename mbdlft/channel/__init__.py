"""Channels of finished models: inverted, in series with blocks, opened for design. numpy only."""

from mbdlft.channel.invert import invert_channels as invert_channels
from mbdlft.channel.series import series as series
from mbdlft.channel.tunable import TunableGain as TunableGain
from mbdlft.channel.tunable import TunablePlant as TunablePlant
from mbdlft.channel.tunable import tunable as tunable
