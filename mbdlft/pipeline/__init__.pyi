from .models import delta_theta as delta_theta
from .models import exact_lower_bound as exact_lower_bound
from .models import linearize_dae as linearize_dae
from .models import realize as realize
from .models import to_lft as to_lft
