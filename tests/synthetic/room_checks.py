"""What tests of rendered rooms share."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from pipeline.synthetic import RenderedFrame, Room, choose_views, make_room, render_view


@lru_cache(maxsize=8)
def room_of(seed: int) -> Room:
    return make_room(seed)


@lru_cache(maxsize=8)
def frame_of(seed: int) -> RenderedFrame:
    with pytest.MonkeyPatch.context() as patch:
        # The best of few cameras and not of many: to choose costs more than to render.
        patch.setattr("pipeline.synthetic.render.CANDIDATES", 8)
        camera = choose_views(room_of(seed), 1, np.random.default_rng(seed), 160, 120)[0]
    return render_view(room_of(seed), camera, np.random.default_rng(0))
