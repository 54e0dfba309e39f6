"""Models as objects of other Python libraries: CasADi, python-control, xarray.

``model.at(values)`` is a ``control.StateSpace`` at one point, and `lpv_grid` a list of them on a grid.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from mbdlft.archive.sweep import Sweep
from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import ArrayLike
from mbdlft.base.errors import StructureError
from mbdlft.export.c import value_function
from mbdlft.export.names import check_plain_model, identifier, identifiers
from mbdlft.response.frequency import frequency_response
from mbdlft.system.model import System
from mbdlft.system.sampled import control_names, matrices_at

if TYPE_CHECKING:
    from control import FrequencyResponseData
    from xarray import Dataset

_DIMENSIONS = {"state": "states", "rate": "states", "input": "inputs", "output": "outputs"}
_DIMENSIONS |= {"trimmed": "trim"}


@arguments_checked
def casadi_function(model: System) -> ca.Function:
    """The state matrices as a CasADi function of the parameters, with its derivatives.

    Parameters
    ----------
    model : System or LFTModel

    Returns
    -------
    casadi.Function
        One input for each parameter, in its unit and under its name (as an identifier), nominal by
        default; outputs A (nx, nx), B (nx, nu), C (ny, nx), D (ny, nu). It takes numbers and symbols;
        no range is checked.
    """
    check_plain_model(model, "CasADi")
    names = list(identifiers(model.parameters.names, f"model {model.name!r}: CasADi").values())
    values = [ca.MX.sym(name) for name in names]
    value, _ = value_function("value", model.parameters, model.lft)(ca.vertcat(*values))
    rows = ca.vertsplit(value.T, [0, len(model.states), model.lft.shape[0]])
    columns = [0, len(model.states), model.lft.shape[1]]
    blocks = [block for row in rows for block in ca.horzsplit(row, columns)]
    nominal = {"default_in": [p.nominal for p in model.parameters]} if names else {}
    name = ca.Function.fix_name(identifier(model.name))  # it has reserved names of its own
    options: dict[str, Any] = {"allow_duplicate_io_names": True, **nominal}  # an area is often called A
    return ca.Function(name, values, blocks, names, list("ABCD"), options)


@arguments_checked
def frequency_data(
    model: System, values: Mapping[str, ArrayLike], omega: ArrayLike
) -> "list[FrequencyResponseData]":
    """Frequency responses at samples as systems of python-control.

    Parameters
    ----------
    model, values, omega : as in `frequency_response`; omega (F,)

    Returns
    -------
    list of control.FrequencyResponseData
        One for each sample, with the names of the signals, dots as underscores.
    """
    import control  # here because it is slow to import

    responses = frequency_response(model, values, omega)
    names = control_names(model, "inputs", "outputs")
    return [
        control.frd(np.moveaxis(each, 0, -1), np.ravel(omega), name=identifier(model.name), **names)
        for each in responses
    ]


@arguments_checked
def dataset(
    source: System | Sweep, values: Mapping[str, ArrayLike] | None = None, omega: ArrayLike | None = None
) -> "Dataset":
    """Matrices, and responses or the rest of a sweep, as labelled arrays of xarray.

    Parameters
    ----------
    source : System, LFTModel or Sweep
        A model, evaluated at `values`; or a sweep, whose samples are taken.
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    omega : array (F,), rad/s, optional
        Frequencies of a model's responses.

    Returns
    -------
    xarray.Dataset
        ``A`` (sample, rate, state), ``B`` (sample, rate, input), ``C`` (sample, output,
        state), ``D`` (sample, output, input); ``response`` (sample, omega, output, input) with `omega`;
        of a sweep ``trim`` (sample, trimmed), ``status``, ``residual``, ``poles`` and the values of the
        user's function, too. Coordinates are the names of signals, with units beside them
        (``input_unit``; rates are per second), and for each parameter its values at the samples, with
        the attribute ``units``.
    """
    import xarray  # an extra

    more: dict[str, Any] = {}
    if isinstance(source, Sweep):
        if values is not None or omega is not None:
            raise StructureError(
                f"sweep {source.name!r}: it has its samples; values and omega are for a model."
            )
        signals = {key: getattr(source.layout, key) for key in ("states", "inputs", "outputs", "trim")}
        matrices: Any = (source.A, source.B, source.C, source.D)
        columns: list[Any] = list(zip(source.layout.parameters, source.samples.T, strict=True))
        more["trim"] = (("sample", "trimmed"), source.trim)
        more |= {"status": ("sample", source.status), "residual": ("sample", source.residual)}
        more |= {name: ("sample", column) for name, column in source.values.items()}
        if source.poles is not None:
            more["poles"] = (("sample", "pole"), source.poles)
    else:
        signals = {key: getattr(source, key) for key in ("states", "inputs", "outputs")}
        matrices = [m[None] if m.ndim == 2 else m for m in matrices_at(source, values or {})]
        count = len(matrices[0])
        known = {p.name: (values or {}).get(p.name, p.nominal) for p in source.parameters}
        columns = [(p, np.broadcast_to(known[p.name], count)) for p in source.parameters]
        if omega is not None:
            response = frequency_response(source, values or {}, omega)
            more["response"] = (("sample", "omega", "output", "input"), response)
    places = {"A": ("rate", "state"), "B": ("rate", "input"), "C": ("output", "state")}
    places["D"] = ("output", "input")
    arrays = {key: (("sample", *places[key]), m) for key, m in zip("ABCD", matrices, strict=True)}
    labels: dict[str, Any] = {p.name: ("sample", column, {"units": p.unit}) for p, column in columns}
    others = {f"{dimension}_unit" for dimension in _DIMENSIONS} | (
        {"omega"} if omega is not None else set()
    )
    clash = sorted(labels.keys() & {*arrays, *more, *_DIMENSIONS, "sample", *others})
    if clash:
        raise StructureError(
            f"{source.name!r}: parameter {clash[0]!r} has the name of an array. Rename it."
        )
    for dimension, key in _DIMENSIONS.items():
        if key in signals:
            labels[dimension] = [s.name for s in signals[key]]
            labels[f"{dimension}_unit"] = (dimension, [s.unit for s in signals[key]])
    if omega is not None:
        labels["omega"] = ("omega", np.ravel(omega), {"units": "rad/s"})
    return xarray.Dataset(arrays | more, labels, {"name": source.name})
