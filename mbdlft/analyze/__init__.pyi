from .response import frequency_response as frequency_response
from .response import singular_values as singular_values
