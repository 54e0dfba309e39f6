"""From a scene to its equations: the tree, its moves, its loads, and the closures of its loops."""

from mbdlft.multibody.assembly.newton_euler import Assembly as Assembly
from mbdlft.multibody.assembly.newton_euler import assemble as assemble
from mbdlft.multibody.assembly.newton_euler import assembly as assembly
