from .gain import robust_performance as robust_performance
from .gain import worst_case_gain as worst_case_gain
from .margin import robust_stability as robust_stability
from .response import frequency_response as frequency_response
from .response import singular_values as singular_values
from .result import Bounds as Bounds
from .singular_value import StructuredSingularValue as StructuredSingularValue
from .singular_value import structured_singular_value as structured_singular_value
