from .block import ComplexBlock as ComplexBlock
from .block import FullBlock as FullBlock
from .lft import LFT as LFT
from .lft import Block as Block
