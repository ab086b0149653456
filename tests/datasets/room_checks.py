"""What tests of rendered rooms share."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pipeline.datasets import Room, choose_views, make_room
from pipeline.datasets.synthetic import RenderedFrame, render_view


@lru_cache(maxsize=8)
def room_of(seed: int) -> Room:
    return make_room(seed)


@lru_cache(maxsize=8)
def frame_of(seed: int) -> RenderedFrame:
    camera = choose_views(room_of(seed), 1, np.random.default_rng(seed), 160, 120)[0]
    return render_view(room_of(seed), camera, np.random.default_rng(0))
