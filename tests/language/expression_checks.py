"""What tests of expressions share."""

from __future__ import annotations

import pytest

from pipeline.language import parse
from pipeline.language.tree import Expression
from pipeline.system import InputError


def expression_of(text: str, **options: object) -> Expression:
    expression = parse(text, **options).expression  # type: ignore[arg-type]
    assert expression is not None
    return expression


def triple(text: str, **options: object) -> tuple[str, str, str]:
    expression = expression_of(text, **options)
    return expression.target, expression.relation, expression.reference


def refused(text: str, **options: object) -> str:
    with pytest.raises(InputError) as caught:
        parse(text, **options)  # type: ignore[arg-type]
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 700
    return message
