from .body_ports import two_port as two_port
from .drive import ArrayDrive as ArrayDrive
from .drive import array_drive as array_drive
from .filter import band_pass as band_pass
from .filter import delay as delay
from .filter import low_pass as low_pass
from .wheel import imbalance as imbalance
