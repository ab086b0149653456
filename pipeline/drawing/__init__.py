"""Pixels by hand: strokes, polygons, rectangles and depth regions as masks.

`gestures` is what a hand has done, checked, and the exact masks that come of it;
`depth_region` grows over a surface from a click. Nothing here knows of labels.
"""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.drawing.gestures import Canvas, Gesture, read_gesture

__getattr__ = lazy_exports(__name__, __file__)
