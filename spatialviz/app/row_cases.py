"""Cases of all rows that are selected in Evaluate, saved one after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.diagnosis.cases.saving import save_case
from pipeline.language.counted import counted
from pipeline.system.errors import InputError
from spatialviz.app.context import Context, Part, command
from spatialviz.app.judging import Judge
from spatialviz.app.markup import BAD, h, note
from spatialviz.app.view_strings import CASES, folder_name

MOST, TOLD = 200, 5
"""Cases that are made at once, and reasons that are told why some are not."""


class RowCases(Part):
    """Makes cases of what `selected` gives: rows of a run."""

    def __init__(self, ctx: Context, judge: Judge, selected: Callable[[], list[dict[str, Any]]]) -> None:
        super().__init__(ctx)
        self._judge, self._selected = judge, selected

    @command("row-cases")
    def make(self) -> None:
        """Save each of the selected as a case; one that is there already stays."""
        rows, count = self._selected(), len(self._selected())
        if count > MOST:
            self.ctx.fail(InputError("so many cases are not made at once", got=count, expected=f"up to {MOST}"))
            return
        saved, refused, there = list[str](), list[str](), list[Path]()

        def make() -> None:
            if not rows:
                self.ctx.page.call("working", "")
                self._tell(saved, refused, len(there))
                return
            row = rows.pop(0)
            self.ctx.page.call("working", f"case {count - len(rows)} of {count}")
            folder = Path(CASES) / folder_name(f"{row['text']}-{row['frame']}")
            if folder.exists():
                there.append(folder)
            else:
                try:
                    self._save(folder, row)
                    saved.append(str(folder))
                except InputError as error:
                    refused.append(f"{row['text']}: {error}")
            self.ctx.post(make)

        self.ctx.post(make)

    def _save(self, folder: Path, row: dict[str, Any]) -> None:
        here, run = self.state, self.ctx.run
        context = self.ctx.shared.store.load(here.source, row["frame"]).context
        # What is judged is what is looked at.
        self.state = replace(here, frame_id=row["frame"])
        try:
            truth = self._judge.truth(self.ctx.source, context)
            known = self._judge.known(truth, row["id"])
        finally:
            self.state = here
        origin = {} if run is None else {"run": str(run.folder), "expression": row["id"]}
        save_case(folder, self.ctx.source, context, row["text"], truth=truth, run=origin, **known)

    def _tell(self, saved: list[str], refused: list[str], there: int) -> None:
        self.ctx.dialog.show(
            "Cases of the selected",
            (
                h.p(f"{counted(len(saved), 'case')} saved{f', {there} were there already' if there else ''}."),
                h.pre("\n".join(saved), cls="file") if saved else None,
                [note(reason, BAD) for reason in refused[:TOLD]],
            ),
        )
