"""Commands on scenes: one world over the posed frames of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, arg

from pipeline.system.frozen import dataclass
from spatialviz.options import ALL_FRAMES, DatasetArg, Flag, FrameArg, Output, ProposalOptions

ProposalArg = OmitArgPrefixes[Annotated[ProposalOptions, arg(help=ProposalOptions.__doc__)]]


@dataclass(frozen=True, kw_only=True)
class MapCommand(Output):
    """Join the objects of a scene's posed frames: which is which, and where each is seen, hidden or missing.

    FRAME is any frame of the scene; without it, all scenes. A map that is there already is gone on from. Exit status: 0
    where frames were joined and none was left out, else 1.
    """

    dataset: DatasetArg
    frame: FrameArg = ALL_FRAMES
    out: Path
    """Folder for the maps, a file a scene."""
    refine: Flag = False
    """Use refined poses where surfaces agree better with them. It is always told how far they move."""
    source: ProposalArg = ProposalOptions()
