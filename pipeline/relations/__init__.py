"""SRM: a probability for each relation of each ordered pair of objects."""

from pathlib import Path

from pipeline.relations.model import OnnxScorer, installed_network, installed_networks
from pipeline.relations.scorer import RelationScorer, RelationScores, RuleScorer
from pipeline.system.errors import InputError, require
from pipeline.system.lazy_exports import lazy_exports
from pipeline.system.paths import asset_path

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.relations.attributes import SIZES, attribute_probabilities, object_colors, size_keys
    from pipeline.relations.contract import NetworkContract
    from pipeline.relations.features import CLI_FEATURES, FEATURES, Appearance, feature_set, with_class_lengths
    from pipeline.relations.model import ClassVectors, install_network, is_named, vectors_path
    from pipeline.relations.pair_measures import AllMeasures, measure_pairs
    from pipeline.relations.relations import (
        PREDICATES,
        PROFILE,
        F,
        Profile,
        T,
        U,
        directional_states,
        letter,
        pair_states,
        pairwise_states,
        predicates_of,
    )
    from pipeline.relations.scorer import rule_probabilities, stacked_extents

__getattr__ = lazy_exports(__name__, __file__)

__all__ = ["RelationScorer", "RelationScores", "RuleScorer", "make_scorer", "shipped_network"]

RULE, TRAINED = "rule", "trained"


def shipped_network() -> Path:
    """File of the network shipped with the program.

    Raises
    ------
    InputError
        Where the installation lacks it.
    """
    return asset_path("srm", "rel32.onnx")


def make_scorer(name: str | Path = RULE, vectors: Path | None = None) -> RelationScorer:
    """Relation scorer by name: "rule", "trained" (the shipped network), the path of an ONNX file, or an installed
    network's name.

    `vectors`: file of text vectors of a language network, needed for classes outside its training.

    Raises
    ------
    InputError
        For an unknown name, or a file that is not a relation network this program can feed.

    >>> make_scorer("rule").name, make_scorer("trained").name
    ('rule', 'rel32')
    """
    require(name != RULE or vectors is None, "the rule uses no class names: leave out --vectors", path=vectors)
    if name == RULE:
        return RuleScorer()
    path = shipped_network() if name == TRAINED else Path(name)
    if path.suffix.lower() != ".onnx" and not path.is_file():
        installed = installed_network(str(name))
        if installed is None:
            names = ", ".join(n.stem for n in installed_networks())
            expected = "trained, rule, an ONNX file, or the name of an installed network"
            raise InputError(
                f"there is no relation scorer {str(name)!r}", expected=f"{expected} ({names})" if names else expected
            )
        path = installed
    return OnnxScorer(path, vectors)
