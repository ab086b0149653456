"""What tests of lifting share."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from pipeline.geometry import viewer_axes

SEEDS = st.integers(0, 2**32 - 1)
LEVEL = viewer_axes(np.array([0, -1.0, 0]))
