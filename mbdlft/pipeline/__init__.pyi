from .dae_models import delta_theta as delta_theta
from .dae_models import linearize_dae as linearize_dae
from .models import exact_lower_bound as exact_lower_bound
from .models import realize as realize
from .models import to_lft as to_lft
