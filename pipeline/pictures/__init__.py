"""Pictures of answers without a screen: over the frame, in 3D, as a card to show, a run's failures, a film.

`marks` draws masks and boxes over a frame, `text` writes, `scene_view` draws the points and boxes in 3D, `answer_card`
puts an answer on one picture, `sheet` a run's failures, `film` two answers in turn.
"""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.pictures.answer_card import answer_picture

__getattr__ = lazy_exports(__name__, __file__)
