"""Synthetic annotated RGB-D rooms: seeded, rendered with a ray caster, written in BOP format."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.synthetic.dataset import RenderReport, render_dataset
    from pipeline.synthetic.layout import Instance, Room
    from pipeline.synthetic.render import (
        RenderedFrame,
        camera_at,
        choose_views,
        exact_view,
        render_view,
        sense,
        sense_view,
    )
    from pipeline.synthetic.rooms import make_room
    from pipeline.synthetic.scattered import make_scattered, roaming_cameras

__getattr__ = lazy_exports(__name__, __file__)
