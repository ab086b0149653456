"""How labels were made, read back from their manifest: what follows from a correction is made in the same way."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from pipeline.geometry.lifting import LiftConfig
from pipeline.labels.check.relations import MIRRORED_PROFILES
from pipeline.labels.config import LabelConfig
from pipeline.labels.reading import Labels
from pipeline.language.relation_names import MIRRORED
from pipeline.system.errors import InputError


@dataclass(frozen=True)
class Setting:
    """What the labels of a run have in common.

    Attributes
    ----------
    config : LabelConfig
    relations : tuple of str
        Those that were labelled, in the order of PAIRWISE.
    class_names : tuple of str
        All names of the labels: sentences must not be mistaken for any of them.
    made_by : str
        Detector and rule profile, for provenance.
    exact : bool
        Objects are numbered as the dataset's own annotations.
    """

    config: LabelConfig
    relations: tuple[str, ...]
    class_names: tuple[str, ...]
    made_by: str
    exact: bool

    def inverse(self, relation: str) -> str | None:
        """What "b ... a" is called where "a RELATION b" is said; None where the profile has no such relation."""
        if self.config.profile not in MIRRORED_PROFILES:
            return None
        found = MIRRORED.get(relation)
        return found if found in self.relations else None


def setting_of(labels: Labels) -> Setting:
    """Read it from the manifest.

    Raises
    ------
    InputError
        The manifest is of labels that this release cannot make.
    """
    manifest = labels.manifest
    detector = str(manifest.models.get("detector", ""))
    names = labels.objects.column("label").unique().to_pylist()
    return Setting(
        _config(manifest.config, labels),
        labels.relation_names,
        tuple(sorted(names)),
        ", ".join(part for part in (detector, str(manifest.profile.get("name", ""))) if part),
        detector.startswith("annotations"),
    )


def _config(record: dict[str, Any], labels: Labels) -> LabelConfig:
    known = {f.name for f in fields(LabelConfig)}
    values = {name: value for name, value in record.items() if name in known}
    try:
        if "lift" in values:
            values["lift"] = LiftConfig(**values["lift"])
        if "background" in values:
            values["background"] = tuple(values["background"])
        return LabelConfig(**values)
    except (TypeError, AttributeError) as error:
        what = "the labels' settings are not those of this release"
        raise InputError(what, got=str(error), path=labels.root) from error
