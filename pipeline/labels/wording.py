"""Placeholder until the wording branch lands."""


def expression_text(target: str, relation: str, reference: str, key: int, *, style: str = "varied") -> str:
    from pipeline.relations import PHRASE

    return f"{target} {PHRASE[relation]} {reference}"
