"""Placeholder until the wording branch lands."""


def expression_text(target: str, relation: str, reference: str, key: int, *, style: str = "varied") -> str:
    from pipeline.relations import PHRASE

    return f"{target} {PHRASE[relation]} {reference}"


def question_text(relation: str, target: str, reference: str, key: int) -> str:
    from pipeline.relations import PHRASE

    return f"Is the {target} {PHRASE[relation]} the {reference}?"


def can_be_said(name: str) -> bool:
    return bool(name.strip())
