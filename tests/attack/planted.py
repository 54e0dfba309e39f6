"""Attacks that fail, so that the runner is seen to notice."""

import os
import time
from pathlib import Path


def attack(seed: int, folder: Path) -> str:
    """Refuse, raise, hang or end the process, by the seed."""
    if seed == 1:
        raise ZeroDivisionError
    if seed == 2:
        time.sleep(600)
    if seed == 3:
        os._exit(7)
    return "refused"
