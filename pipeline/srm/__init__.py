"""SRM: a probability for each relation of each ordered pair of objects."""

from pipeline.srm.scorer import RelationScorer, RelationScores, RuleScorer

__all__ = ["RelationScorer", "RelationScores", "RuleScorer", "make_scorer"]


def make_scorer(name: str = "rule") -> RelationScorer:
    """The relation scorer of that name.

    Raises
    ------
    InputError
        For an unknown name.
    """
    from pipeline.errors import InputError

    if name != "rule":
        raise InputError(f"there is no relation scorer {name!r}", expected="rule")
    return RuleScorer()
