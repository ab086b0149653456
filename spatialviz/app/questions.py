"""Questions that a press asks: another relation of the same names, the last question, a suggested one."""

from __future__ import annotations

from collections.abc import Callable

from pipeline.language.relation_names import PHRASE
from spatialviz.app.context import Context, Part, command, there


class Questions(Part):
    """Asks for a client what the page offers."""

    def __init__(self, ctx: Context, ask: Callable[[str], None]) -> None:
        super().__init__(ctx)
        self._ask = ask

    @command("relation")
    def _ask_relation(self, number: int) -> None:
        """Ask the same names with another relation."""
        trace = there(self.state.trace)
        ends = trace.query.target, there(trace.asked).nodes[0].label
        if 0 <= number < len(trace.scores.relations):
            first, second = ends[::-1] if trace.inverse else ends
            self._ask(f"{first} {PHRASE[trace.scores.relations[number]]} the {second}")

    @command("again")
    def _ask_again(self) -> None:
        self._ask(self.state.text)

    @command("try")
    def _try(self, number: int) -> None:
        if 0 <= number < len(self.state.offers.questions):
            self._ask(self.state.offers.questions[number])
