function [rates, y, zeta] = <<stem>>_rates(x, u, values, zeta)
% <<stem>>_rates  Derivatives of the states and outputs of a model with its nonlinear functions Theta.
%
%   [rates, y] = <<stem>>_rates(x, u)                columns x and u; the parameters are nominal
%   [rates, y, zeta] = <<stem>>_rates(x, u, values)  physical values of parameters, as in <<stem>>_at
%   ... = <<stem>>_rates(x, u, values, zeta)         Theta is searched near zeta
%   [zeta, slopes] = <<stem>>_rates(omega)           Theta alone
%
% Model: <<model>>. Written by mbdlft.
<<table>>
%
% The numbers are in <<stem>>.mat, the matrices in <<stem>>_at.m. Runs in MATLAB and Octave. In a simulation:
%   [t, x] = ode15s(@(t, x) <<stem>>_rates(x, u), [0 1], model.theta.initial)
  persistent model last A B C D
  if isempty(model)
    model = load(fullfile(fileparts(mfilename('fullpath')), '<<stem>>.mat'));
    last = NaN;
  end
  t = model.theta;
  if nargin == 1
    omega = double(x(:));
    check_range(t, omega);
    [rates, y] = theta(omega, t.table);
    return
  end
  if nargin < 3
    values = struct();
  end
  if nargin < 4
    zeta = t.zeta_at_start;
  end
  if ~isequal(last, values)
    [A, B, C, D] = <<stem>>_at(values);
    last = values;
  end
  x = double(x(:));
  given = zeros(size(B, 2), 1);
  given(t.u) = double(u);
  given(t.one) = 1;
  known = C(t.omega, :) * x + D(t.omega, :) * given;
  [zeta, omega] = solve(known, D(t.omega, t.zeta), double(zeta(:)), t.table);
  check_range(t, omega);
  given(t.zeta) = zeta;
  rates = A * x + B * given;
  y = C(t.y, :) * x + D(t.y, :) * given;
end

function check_range(t, omega)
  for k = 1:numel(omega)
    if ~(omega(k) >= t.low(k) && omega(k) <= t.high(k))
      error('mbdlft:range', 'Theta is evaluated at %s = %g, outside of its range [%g, %g].', ...
            t.omega_name{k}, omega(k), t.low(k), t.high(k));
    end
  end
end

function [zeta, omega] = solve(known, D, zeta, table)
% zeta = Theta(known + D zeta), by Newton's method with halved steps
  last = Inf;
  factor = 1;
  more = 1;
  for turn = 1:400
    omega = known + D * zeta;
    [at, slopes] = theta(omega, table);
    if turn > 1 && factor > 1e-6
      now = norm((at - zeta) ./ scale);
      if ~(now < last * (1 - 0.1 * factor)) && ~(now <= 1e-12)
        factor = factor / 2;
        zeta = from + factor * step;
        continue
      end
    end
    scale = abs(zeta) + abs(at) + abs(slopes) * (abs(known) + abs(D) * abs(zeta));
    parts = (at - zeta) ./ max(scale, 1e-300);
    if ~all(isfinite(parts))
      break
    end
    if max(abs(parts)) <= 1e-12
      if more == 0
        return
      end
      more = more - 1;
    end
    scale = max(scale, 1);
    last = norm((at - zeta) ./ scale);
    factor = 1;
    from = zeta;
    step = (eye(numel(zeta)) - slopes * D) \ (at - zeta);
    zeta = from + step;
  end
  error('mbdlft:unsolved', 'the values of Theta were not found near those that were given.');
end

function [zeta, slopes] = theta(omega, table)
% The functions of Theta, and their slopes.
  zeta = zeros(<<nz>>, 1);
  slopes = zeros(<<nz>>, <<no>>);
<<bodies>>
end

function found = choose(condition, a, b)
  if condition
    found = a;
  else
    found = b;
  end
end

function found = table_value(t, a, slope)
% A table at an argument: lines or cubic polynomials between the points, lines beyond.
  b = t.breakpoint;
  v = t.value;
  n = numel(b);
  if a < b(1)
    found = choose(slope, t.below, v(1) + t.below * (a - b(1)));
    return
  elseif a > b(n)
    found = choose(slope, t.above, v(n) + t.above * (a - b(n)));
    return
  end
  k = min(max(sum(b <= a), 1), n - 1);
  h = b(k+1) - b(k);
  rise = v(k+1) - v(k);
  at = (a - b(k)) / h;
  if isempty(t.slope)
    found = choose(slope, rise / h, v(k) + at * rise);
    return
  end
  left = h * t.slope(k, 1) - rise;
  right = h * t.slope(k, 2) - rise;
  bend = (1 - at) * left - at * right;
  if slope
    found = (rise + (1 - 2 * at) * bend - at * (1 - at) * (left + right)) / h;
  else
    found = v(k) + at * rise + at * (1 - at) * bend;
  end
end
