from .text import flat_model as flat_model
