"""Models of actuators: linear blocks to put in series with channels, and pieces of scenes."""

from mbdlft.actuator.drive import ArrayDrive as ArrayDrive
from mbdlft.actuator.drive import array_drive as array_drive
from mbdlft.actuator.filter import band_pass as band_pass
from mbdlft.actuator.filter import delay as delay
from mbdlft.actuator.filter import low_pass as low_pass
from mbdlft.actuator.wheel import imbalance as imbalance
