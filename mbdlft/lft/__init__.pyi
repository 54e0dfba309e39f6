from .lft import LFT as LFT
from .lft import Block as Block
