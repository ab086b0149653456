"""Scenes: one world over the posed frames of a recording.

Views of the same surfaces, agreement of their poses, world objects with one identity, and labels carried from frame to
frame. Above `answering`; nothing below knows of it.
"""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.scenes.map_files import read_map, save_map
    from pipeline.scenes.move_check import robot_moves
    from pipeline.scenes.object_map import map_scene
    from pipeline.scenes.propagation import propagate
    from pipeline.scenes.views import PosedView, posed_frames

__getattr__ = lazy_exports(__name__, __file__)
