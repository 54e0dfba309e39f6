"""The inward pass as it is in the books: a displaced joint turns the forces that pass it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from unittest.mock import patch

import casadi as ca

from mbdlft.scene.placed import Motions, Passed, Placed, pass_inward


@contextmanager
def forces_turned_on_the_way() -> Iterator[None]:
    """Scenes are assembled with it, also where weights could be felt in the axes of each lever."""
    with patch.object(import_module("mbdlft.scene.assemble"), "pass_weights_inward", _pass):
        yield


def _pass(
    placed: Placed,
    found: Motions,
    inertial: Mapping[str, ca.SX],
    loads: Mapping[str, ca.SX],
    load: ca.SX,
) -> Passed:
    return pass_inward(placed, found, {name: inertial[name] + loads[name] for name in inertial})
