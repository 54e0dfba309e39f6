function [A, B, C, D, trim] = <<stem>>_at(values)
% <<stem>>_at  State matrices of a model at physical values of its parameters. Written by mbdlft.
%
%   [A, B, C, D] = <<stem>>_at(values)        values: a structure of numbers, nominal where it has no field
%   [A, B, C, D, trim] = <<stem>>_at(values)  trim: what holds the equilibrium, empty if it is not stored
%
% Model: <<model>>
<<table>>
%
% The numbers are in <<stem>>.mat, which must be in the folder of this file. Runs in MATLAB and Octave.
  persistent model
  if isempty(model)
    model = load(fullfile(fileparts(mfilename('fullpath')), '<<stem>>.mat'));
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
    value = double(value); % integers would round what follows
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
      part = double(values.(blocks.identifier{k}));
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
