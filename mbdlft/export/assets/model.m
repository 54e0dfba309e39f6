% <<stem>>  A model with its parameters left in: the variable plant. Written by mbdlft.
%
% With the Robust Control Toolbox, plant is an uncertain system (uss) of ureal elements, each repeated as
% often as in the model. An angle is a ureal element tan_half_NAME, the tangent of half of its distance
% from its reference, or tan_quarter_NAME; parameters.internal has the ranges. Blocks that are no
% parameters are ucomplex and ultidyn elements. States, inputs and outputs have their names and units;
% model.parameters has those of the parameters, beside the ranges.
%
% Otherwise, as in Octave, plant is a structure of the plain matrices A, B, C, D and the trim at physical
% values: those in the structure values, if there is one when the script starts; the others are nominal.
%
% Model: <<model>>
<<table>>

mbdlft_folder = fileparts(mfilename('fullpath'));
model = load(fullfile(mbdlft_folder, '<<stem>>.mat'));
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
  plant.StateName = model.states.name;
  plant.StateUnit = model.states.unit;
  if ~isempty(mbdlft_parts)
    plant = lft(blkdiag(mbdlft_parts{:}), plant);
  end
  plant.InputName = model.inputs.name;
  plant.InputUnit = model.inputs.unit;
  plant.OutputName = model.outputs.name;
  plant.OutputUnit = model.outputs.unit;
else
  if ~exist('values', 'var')
    values = struct();
  end
  plant = struct();
  [plant.A, plant.B, plant.C, plant.D, plant.trim] = <<stem>>_at(values);
end
clear -regexp ^mbdlft_
