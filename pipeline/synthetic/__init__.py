"""Synthetic annotated RGB-D rooms: seeded, rendered with a ray caster, written in BOP format."""

from pipeline.synthetic.dataset import RenderReport, render_dataset
from pipeline.synthetic.layout import Instance, Room
from pipeline.synthetic.render import RenderedFrame, exact_view, render_view, sense_view
from pipeline.synthetic.rooms import make_room
from pipeline.synthetic.views import camera_at, choose_views

__all__ = [
    "Instance",
    "RenderReport",
    "RenderedFrame",
    "Room",
    "camera_at",
    "choose_views",
    "exact_view",
    "make_room",
    "render_dataset",
    "render_view",
    "sense_view",
]
