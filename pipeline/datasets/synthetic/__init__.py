"""Synthetic annotated RGB-D rooms: seeded, rendered with a ray caster, written in BOP format."""

from pipeline.datasets.synthetic.dataset import RenderReport, render_dataset
from pipeline.datasets.synthetic.layout import Instance, Room
from pipeline.datasets.synthetic.render import (
    RenderedFrame,
    camera_at,
    choose_views,
    exact_view,
    render_view,
    sense_view,
)
from pipeline.datasets.synthetic.rooms import make_room

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
