"""Where a model comes from: the text it was made of, versions, the time."""

from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version

import numpy as np

from mbdlft.system.model import Provenance


def provenance(text: str) -> Provenance:
    """Versions, the time, and the TOML text that a model is made from."""
    return Provenance(
        scene=text,
        mbdlft=_version("mbdlft"),
        casadi=_version("casadi"),
        numpy=np.__version__,
        h5py=_version("h5py"),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )


@cache
def _version(package: str) -> str:
    return version(package)
