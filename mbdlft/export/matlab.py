"""MATLAB and Octave: the numbers of a model in a .mat file (version 5), and two m-files that use them.

In the texts of the m-files ``$$`` is a dollar sign, and other names with ``$`` are filled in. Both run in
Octave; the uncertain elements need the Robust Control Toolbox of MATLAB.
"""

from collections.abc import Sequence
from io import BytesIO
from string import Template
from typing import Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.parameter import DIVISORS, Parameter, to_internal
from mbdlft.base.unit import Signal
from mbdlft.export.names import check_different, identifier, identifiers, one_line
from mbdlft.lft.lft import LFT
from mbdlft.system.model import LFTModel, System

_MATRICES = ("A", "B_w", "B_u", "C_z", "D_zw", "D_zu", "C_y", "D_yw", "D_yu")
_TANGENT = {"identity": "", "half-angle": "tan_half_", "quarter-angle": "tan_quarter_"}
_HEADER = 116  # bytes of text at the beginning of a file of version 5


def matlab_image(items: dict[str, Any]) -> bytes:
    """The bytes of a .mat file of version 5; equal for equal items, without the time and the machine."""
    from scipy.io import savemat

    stream = BytesIO()
    savemat(stream, items, format="5", oned_as="column", do_compression=True)
    return b"MATLAB 5.0 MAT-file, written by mbdlft".ljust(_HEADER) + stream.getvalue()[_HEADER:]


def items_of_matlab(model: System) -> dict[str, Any]:
    """Variables of the .mat file of a model: matrices, and structures of columns."""
    names = identifiers([block.name for block in model.lft.blocks], f"model {model.name!r}: MATLAB")
    items: dict[str, Any] = {
        "format": "mbdlft-mat/1",
        "name": model.name,
        "description": model.description,
        **{name: getattr(model, name) for name in _MATRICES},
        "states": signals(model.states),
        "inputs": signals(model.inputs),
        "outputs": signals(model.outputs),
        "delta": _blocks(model.lft, model.parameters, names),
        "parameters": _parameters(model, names),
    }
    if isinstance(model, LFTModel):
        lft = model.trim.lft
        items["trim"] = {**signals(model.trim.signals), "nominal": column(model.trim.nominal)}
        if lft is not None:
            items["trim"]["lft"] = {
                "D_zw": lft.M11,
                "D_zu": lft.M12,
                "D_yw": lft.M21,
                "D_yu": lft.M22,
                "delta": _blocks(lft, model.parameters, names),
            }
    return items


def cells(texts: Sequence[str]) -> Any:
    """A column of texts, which MATLAB calls a cell array."""
    column = np.empty((len(texts), 1), dtype=object)
    column[:, 0] = texts
    return column


def column(numbers: Sequence[float]) -> Array:
    """Numbers as a column (n, 1)."""
    return np.asarray(numbers, dtype=float).reshape(-1, 1)


def signals(listed: Sequence[Signal]) -> dict[str, Any]:
    """Names and units of signals as columns."""
    return {"name": cells([s.name for s in listed]), "unit": cells([s.unit for s in listed])}


def _blocks(lft: LFT, parameters: Sequence[Parameter], names: dict[str, str]) -> dict[str, Any]:
    """The blocks of Delta; `parameter` is the number of each in the parameters from 1 on, or 0."""
    numbers = {p.name: k for k, p in enumerate(parameters, start=1)}
    return {
        "name": cells([b.name for b in lft.blocks]),
        "identifier": cells([names[b.name] for b in lft.blocks]),
        "kind": cells([b.kind for b in lft.blocks]),
        "rows": column([b.outputs for b in lft.blocks]),
        "columns": column([b.inputs for b in lft.blocks]),
        "parameter": column([numbers.get(b.name, 0) for b in lft.blocks]),
    }


def _parameters(model: System, names: dict[str, str]) -> dict[str, Any]:
    """The parameters, with the maps from physical values to deltas."""
    parameters = model.parameters
    elements = {p.name: _TANGENT[p.substitution] + names[p.name] for p in parameters}
    others = {b.name: names[b.name] for b in model.lft.blocks if b.kind != "real"}
    check_different({**elements, **others}, f"model {model.name!r}: uncertain elements of MATLAB")
    table: dict[str, Any] = {
        "name": cells([p.name for p in parameters]),
        "identifier": cells([names[p.name] for p in parameters]),
        "element": cells([elements[p.name] for p in parameters]),
    }
    for name in ("unit", "role", "substitution"):
        table[name] = cells([getattr(p, name) for p in parameters])
    for name in ("nominal", "low", "high", "reference"):
        table[name] = column([getattr(p, name) for p in parameters])
    internal = [to_internal(p, [p.low, p.nominal, p.high]) for p in parameters]
    maps = [(p.map.b0, p.map.b1, p.map.a1) for p in parameters]
    return {
        **table,
        # what one unit is inside the tangent, rad; 1 without a substitution
        "factor": column([p.factor if p.is_angle else 1.0 for p in parameters]),
        "divisor": column([DIVISORS[p.substitution] for p in parameters]),
        "internal": np.array(internal).reshape(-1, 3),
        "map": np.array(maps).reshape(-1, 3),
        "gain": column([p.map.gain for p in parameters]),
    }


def m_texts(model: System, stem: str) -> tuple[str, str]:
    """The script of the .mat file, and the function that evaluates it at physical values.

    The script makes an uncertain system, or plain matrices.
    """
    table = "\n".join(table_of(model, "%   "))
    entries = {"stem": stem, "model": one_line(model.name), "table": table}
    script, evaluation = (Template(text).substitute(entries) for text in (SCRIPT, EVALUATION))
    return script, evaluation


def table_of(model: System, begin: str, shown: dict[str, str] | None = None) -> list[str]:
    """Lines of a comment: which name became which, ranges and units, and the signals."""
    rows = [("name there", "name in mbdlft", "low", "nominal", "high", "unit")]
    for p in model.parameters:
        name = (shown or {}).get(p.name, identifier(p.name))
        rows.append((name, p.name, f"{p.low:.7g}", f"{p.nominal:.7g}", f"{p.high:.7g}", p.unit))
    for block in model.lft.blocks:
        if block.kind != "real":
            size = f"{block.outputs} x {block.inputs}"
            rows.append((identifier(block.name), block.name, "", "0", "", f"{block.kind}, {size}"))
    widths = [max(map(len, entries)) + 2 for entries in zip(*rows, strict=True)]
    lines = ["".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) for row in rows]
    if len(rows) == 1:
        lines = ["(no parameters)"]
    kinds = [("states", model.states), ("inputs", model.inputs), ("outputs", model.outputs)]
    if isinstance(model, LFTModel):
        kinds.append(("trim", model.trim.signals))
    for what, signals in kinds:
        listed = ", ".join(f"{s.name} ({s.unit})" for s in signals) or "none"
        lines.append(f"{what}: {listed}")
    return [f"{begin}{one_line(line)}".rstrip() for line in lines]


EVALUATION = r"""function [A, B, C, D, trim] = ${stem}_at(values)
% ${stem}_at  State matrices of a model at physical values of its parameters. Written by mbdlft.
%
%   [A, B, C, D] = ${stem}_at(values)        values: a structure of numbers, nominal where it has no field
%   [A, B, C, D, trim] = ${stem}_at(values)  trim: what holds the equilibrium, empty if it is not stored
%
% Model: $model
$table
%
% The numbers are in $stem.mat, which must be in the folder of this file. Runs in MATLAB and Octave.
  persistent model
  if isempty(model)
    model = load(fullfile(fileparts(mfilename('fullpath')), '$stem.mat'));
  end
  if nargin < 1
    values = struct();
  end
  deltas = deltas_of(model.parameters, model.delta, values);
  n = numel(model.states.name);
  M = close_loop(model.delta, deltas, values, model.D_zw, [model.C_z, model.D_zu], ...
                 [model.B_w; model.D_yw], [model.A, model.B_u; model.C_y, model.D_yu]);
  A = M(1:n, 1:n);
  B = M(1:n, n+1:end);
  C = M(n+1:end, 1:n);
  D = M(n+1:end, n+1:end);
  trim = [];
  if nargout > 4 && isfield(model, 'trim') && isfield(model.trim, 'lft')
    t = model.trim.lft;
    trim = close_loop(t.delta, deltas, values, t.D_zw, t.D_zu, t.D_yw, t.D_yu);
  end
end

function deltas = deltas_of(p, blocks, values)
% Normalized deltas of physical values; the others are nominal, that is 0.
  names = p.identifier(:);
  given = fieldnames(values);
  for k = 1:numel(given)
    if ~any(strcmp(given{k}, [names; blocks.identifier(:)]))
      error('mbdlft:name', 'unknown parameter %s. Existing:%s.', given{k}, sprintf(' %s', names{:}));
    end
  end
  deltas = zeros(numel(names), 1);
  for k = 1:numel(names)
    if ~isfield(values, names{k})
      continue
    end
    value = values.(names{k});
    if ~(isnumeric(value) && isscalar(value) && isreal(value))
      error('mbdlft:value', '%s: expected one real number.', names{k});
    end
    slack = 1e-9 * (p.high(k) - p.low(k));
    if ~(value >= p.low(k) - slack && value <= p.high(k) + slack)
      error('mbdlft:range', '%s = %g is outside its range [%g, %g] %s.', names{k}, value, ...
            p.low(k), p.high(k), p.unit{k});
    end
    internal = value;
    if ~strcmp(p.substitution{k}, 'identity')
      internal = tan((value * p.factor(k) - p.reference(k)) / p.divisor(k));
    end
    distance = internal - p.map(k, 1);
    deltas(k) = distance / (p.gain(k) - p.map(k, 3) * distance);
  end
end

function M = close_loop(blocks, deltas, values, M11, M12, M21, M22)
% M22 + M21 Delta (I - M11 Delta)^-1 M12
  Delta = zeros(sum(blocks.rows), sum(blocks.columns));
  w = 0;
  z = 0;
  for k = 1:numel(blocks.rows)
    rows = blocks.rows(k);
    columns = blocks.columns(k);
    if blocks.parameter(k) > 0
      part = deltas(blocks.parameter(k)) * eye(rows);
    elseif isfield(values, blocks.identifier{k})
      part = values.(blocks.identifier{k});
      if strcmp(blocks.kind{k}, 'complex')
        part = part * eye(rows);
      end
      if ~isequal(size(part), [rows, columns])
        error('mbdlft:value', '%s: expected %d x %d numbers.', blocks.identifier{k}, rows, columns);
      end
    else
      part = zeros(rows, columns);
    end
    Delta(w+1:w+rows, z+1:z+columns) = part;
    w = w + rows;
    z = z + columns;
  end
  M = M22;
  if isempty(Delta)
    return
  end
  loop = eye(size(M11, 1)) - M11 * Delta;
  % rows and columns of one size: units do not count
  rows = max(abs(loop), [], 2);
  rows(rows == 0) = 1;
  loop = diag(1 ./ rows) * loop;
  columns = max(abs(loop), [], 1);
  columns(columns == 0) = 1;
  loop = loop * diag(1 ./ columns);
  if ~(rcond(loop) > eps)
    error('mbdlft:singular', 'the model is singular at these values, and has no value there.');
  end
  M = M22 + M21 * (Delta * (diag(1 ./ columns) * (loop \ (diag(1 ./ rows) * M12))));
end
"""

SCRIPT = r"""% $stem  A model with its parameters left in: the variable plant. Written by mbdlft.
%
% With the Robust Control Toolbox, plant is an uncertain system (uss) of ureal elements, each repeated as
% often as in the model. An angle is a ureal element tan_half_NAME, the tangent of half of its distance
% from its reference, or tan_quarter_NAME; parameters.internal has the ranges. Blocks that are no
% parameters are ucomplex and ultidyn elements.
%
% Otherwise, as in Octave, plant is a structure of the plain matrices A, B, C, D and the trim at physical
% values: those in the structure values, if there is one when the script starts; the others are nominal.
%
% Model: $model
$table

mbdlft_folder = fileparts(mfilename('fullpath'));
model = load(fullfile(mbdlft_folder, '$stem.mat'));
if exist('ureal') && exist('uss') %#ok<EXIST>
  mbdlft_parts = {};
  mbdlft_inner = model.D_zw;
  mbdlft_right = [model.C_z, model.D_zu];
  mbdlft_first = 0;
  for mbdlft_k = 1:numel(model.delta.rows)
    mbdlft_row = mbdlft_first + (1:model.delta.columns(mbdlft_k));
    mbdlft_first = mbdlft_first + model.delta.columns(mbdlft_k);
    if isempty(mbdlft_row)
      continue
    end
    mbdlft_p = model.delta.parameter(mbdlft_k);
    mbdlft_name = model.delta.identifier{mbdlft_k};
    mbdlft_size = [model.delta.rows(mbdlft_k), model.delta.columns(mbdlft_k)];
    if mbdlft_p > 0
      % delta = q / (gain - a1 q) with q = internal - b0: w = q v with v = (z + a1 w) / gain
      mbdlft_range = model.parameters.internal(mbdlft_p, :);
      mbdlft_element = ureal(model.parameters.element{mbdlft_p}, mbdlft_range(2), ...
                             'Range', mbdlft_range([1, 3]));
      mbdlft_part = (mbdlft_element - mbdlft_range(2)) * eye(mbdlft_size(1));
      mbdlft_a1 = model.parameters.map(mbdlft_p, 3);
      mbdlft_gain = model.parameters.gain(mbdlft_p);
      mbdlft_inner(mbdlft_row, mbdlft_row) = ...
        mbdlft_inner(mbdlft_row, mbdlft_row) + mbdlft_a1 * eye(mbdlft_size(1));
      mbdlft_inner(mbdlft_row, :) = mbdlft_inner(mbdlft_row, :) / mbdlft_gain;
      mbdlft_right(mbdlft_row, :) = mbdlft_right(mbdlft_row, :) / mbdlft_gain;
    elseif strcmp(model.delta.kind{mbdlft_k}, 'complex')
      mbdlft_part = ucomplex(mbdlft_name, 0) * eye(mbdlft_size(1));
    else
      mbdlft_part = ultidyn(mbdlft_name, mbdlft_size);
    end
    mbdlft_parts{end+1} = mbdlft_part; %#ok<SAGROW>
  end
  mbdlft_n = numel(model.states.name);
  plant = ss(model.A, [model.B_w, model.B_u], [mbdlft_right(:, 1:mbdlft_n); model.C_y], ...
             [mbdlft_inner, mbdlft_right(:, mbdlft_n+1:end); model.D_yw, model.D_yu]);
  if ~isempty(mbdlft_parts)
    plant = lft(blkdiag(mbdlft_parts{:}), plant);
  end
  plant.InputName = model.inputs.name;
  plant.OutputName = model.outputs.name;
else
  if ~exist('values', 'var')
    values = struct();
  end
  plant = struct();
  [plant.A, plant.B, plant.C, plant.D, plant.trim] = ${stem}_at(values);
end
clear -regexp ^mbdlft_
"""
