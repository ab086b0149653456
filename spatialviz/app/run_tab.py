"""The Run tab of one client: figures of the run of its dataset, worked out behind whatever the user does."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from spatialviz.app.layout import Page
from spatialviz.app.run_figures import RunFigures
from spatialviz.app.run_html import CUTS, confusion_html, slices_html, summary_html


class RunTab:
    """Shows the figures of the run of the source that a client looks at.

    Parameters
    ----------
    figures : mapping of str to RunFigures
        By name of the source.
    page : Page
    post : callable
        Runs something later, on the client's own thread.
    """

    def __init__(
        self, figures: Mapping[str, RunFigures], page: Page, post: Callable[[Callable[[], None]], None]
    ) -> None:
        self._figures, self._page, self._post = figures, page, post
        self._cut = next(iter(CUTS))
        self._shown: RunFigures | None = None

    def show(self, source: str) -> None:
        """Show the run of a source, one part after the other."""
        figures = self._shown = self._figures.get(source)
        page = self._page
        for region in ("run-summary", "run-slices", "run-confusion"):
            page.show(region)
        if figures is None:
            return

        def draw(part: Callable[[], None]) -> None:
            self._post(lambda: part() if self._shown is figures else None)

        draw(lambda: page.show("run-summary", summary_html(figures)))
        draw(self._draw_slices)
        draw(lambda: page.show("run-confusion", confusion_html(figures)))

    def cut(self, dimension: str) -> None:
        """Cut the run by another dimension."""
        if dimension in CUTS:
            self._cut = dimension
            self._draw_slices()

    def _draw_slices(self) -> None:
        if self._shown is not None:
            self._page.show("run-slices", slices_html(self._shown, self._cut))
