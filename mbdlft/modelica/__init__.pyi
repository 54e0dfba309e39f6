from .load import load_modelica as load_modelica
from .table import ModelicaTable as ModelicaTable
from .table import load_modelica_table as load_modelica_table
from .table import modelica_table_from_toml as modelica_table_from_toml
from .text import flat_model as flat_model
from .translate import ModelicaReport as ModelicaReport
from .translate import translate as translate
from .tree import FlatModel as FlatModel
