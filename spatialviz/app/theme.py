"""Dark and light."""

from __future__ import annotations

import viser


def apply_theme(gui: viser.GuiApi, dark: bool) -> None:
    """Dark or light, without viser's logo and without its share button, which would send data away."""
    gui.configure_theme(
        dark_mode=dark,
        show_logo=False,
        show_share_button=False,
        control_width="medium",
        brand_color=(66, 118, 232),
    )
