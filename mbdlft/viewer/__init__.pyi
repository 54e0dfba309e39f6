from .page import Page as Page
from .page import scene_of as scene_of
from .page import view as view
