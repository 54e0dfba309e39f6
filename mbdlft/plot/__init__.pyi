from .bode import save_bode as save_bode
from .figures import check_figure as check_figure
from .growth import save_growth as save_growth
from .mu import save_mu as save_mu
from .pole_map import save_pole_map as save_pole_map
from .singular_values import save_singular_values as save_singular_values
from .times import save_step as save_step
