"""Frozen dataclasses that compile late are those of the standard library."""

from __future__ import annotations

import dataclasses
import inspect
import pickle
from abc import ABC, abstractmethod
from collections.abc import Callable
from copy import copy, deepcopy
from dataclasses import field
from threading import Barrier, Thread
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.system.frozen import dataclass as late


def classes(made: Callable[..., Any]) -> list[type]:
    """Classes of every kind that the project has, by a maker."""

    @made(frozen=True)
    class Plain:
        a: int
        b: str = "b"
        c: list[int] = field(default_factory=list)

    @made(frozen=True)
    class Hidden:
        a: int
        b: str = field(default="b", repr=False, compare=False)
        c: int = field(default=0, init=False)

    @made(frozen=True)
    class Checked:
        a: int
        b: tuple[int, ...] = ()

        def __post_init__(self) -> None:
            object.__setattr__(self, "a", int(self.a) + 1)

    @made(frozen=True)
    class Below(Plain):
        d: float = 0.0

    @made(frozen=True, kw_only=True)
    class Named(Plain):
        e: int

    @made(frozen=True)
    class PartlyNamed:
        a: int
        e: int = field(kw_only=True)
        b: int = 2

    @made(frozen=True)
    class OwnWords:
        a: int

        def __repr__(self) -> str:
            return "mine"

        def __eq__(self, other: object) -> bool:
            return isinstance(other, OwnWords)

    @made(frozen=True, eq=False)
    class ByIdentity:
        a: int

    @made(frozen=True)
    class Empty:
        pass

    @made(frozen=True)
    class One:
        a: int

    @made(frozen=True, order=True)
    class Ordered:
        a: int

    @made(frozen=True, slots=True)
    class Slotted:
        a: int

    return [
        *(Plain, Hidden, Checked, Below, Named, PartlyNamed, OwnWords, ByIdentity, Empty, One, Ordered, Slotted),
    ]


PAIRS = list(zip(classes(late), classes(dataclasses.dataclass), strict=True))


@pytest.mark.parametrize(("ours", "standard"), PAIRS, ids=lambda cls: cls.__name__)
def test_as_the_standard_library(ours: type, standard: type) -> None:
    assert str(inspect.signature(ours)) == str(inspect.signature(standard))
    assert [(f.name, f.type) for f in dataclasses.fields(ours)] == [
        (f.name, f.type) for f in dataclasses.fields(standard)
    ]
    assert ours.__match_args__ == standard.__match_args__  # pyright: ignore[reportAttributeAccessIssue]
    needed = {n: 3 for n, p in inspect.signature(standard).parameters.items() if p.default is p.empty}
    a, b = ours(**needed), standard(**needed)
    assert repr(a) == repr(b)
    assert (a == ours(**needed)) == (b == standard(**needed))
    assert a != b
    assert a != 3
    if b == standard(**needed) and all(f.compare is False or f.name != "c" for f in dataclasses.fields(standard)):
        assert hash(a) == hash(ours(**needed))
    assert dataclasses.asdict(a) == dataclasses.asdict(b)
    for name in (*(f.name for f in dataclasses.fields(ours)), "strange"):
        with pytest.raises((dataclasses.FrozenInstanceError, TypeError)):
            setattr(a, name, 1)
        with pytest.raises((dataclasses.FrozenInstanceError, TypeError, AttributeError)):
            delattr(a, name)
    with pytest.raises(TypeError):
        ours(**needed, no_such_field=1)
    assert (ours.__hash__ is None) == (standard.__hash__ is None)


@late(frozen=True)
class Sent:
    """Class at the top of a module, which alone can be pickled."""

    a: int
    b: tuple[int, ...] = ()
    c: dict[str, int] = field(default_factory=dict, compare=False)


@given(st.integers(), st.lists(st.integers()).map(tuple))
def test_values(a: int, b: tuple[int, ...]) -> None:
    value = Sent(a, b)
    for other in (pickle.loads(pickle.dumps(value)), copy(value), deepcopy(value), dataclasses.replace(value)):
        assert other == value
        assert hash(other) == hash(value)
        assert other.c == {}
    assert (Sent(a, b) == Sent(a + 1, b)) is False
    assert dataclasses.replace(value, a=0).a == 0
    assert Sent(a).c is not Sent(a).c


def test_pickled_before_it_is_made() -> None:
    """A worker is sent instances of classes that it never made."""

    def fresh() -> type:
        @late(frozen=True)
        class Fresh:
            a: int

        return Fresh

    made, unmade = fresh()(3), fresh()
    strange = object.__new__(unmade)
    strange.__dict__.update(vars(made))
    assert strange == strange
    assert repr(strange).endswith("Fresh(a=3)")
    assert strange.a == 3
    with pytest.raises(dataclasses.FrozenInstanceError):
        strange.a = 4
    assert hash(strange) == hash(strange)


def test_abstract_classes_stay_abstract() -> None:
    @late(frozen=True)
    class Shape(ABC):
        a: int

        @abstractmethod
        def area(self) -> float: ...

    @late(frozen=True)
    class Square(Shape):
        def area(self) -> float:
            return self.a**2

    with pytest.raises(TypeError, match="abstract"):
        Shape(1)  # pyright: ignore[reportAbstractUsage]
    assert Square(3).area() == 9


def test_first_made_in_many_threads() -> None:
    for _ in range(50):

        @late(frozen=True)
        class Raced:
            a: int
            b: int = 2

        start, made = Barrier(4), list[Any]()

        def make(start: Barrier = start, made: list[Any] = made, kind: Any = Raced) -> None:
            start.wait()
            made.append(kind(1))

        threads = [Thread(target=make) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert made == [Raced(1)] * 4


def test_a_value_within_itself_is_told() -> None:
    value = Sent(1, c={})
    value.c["self"] = value  # pyright: ignore[reportArgumentType]
    assert "..." in repr(value)


def test_a_function_that_is_not_compiled_yet_is_bound_as_python_3_13_binds_it() -> None:
    """There `inspect.signature` of a class takes the class for an instance of its metaclass."""

    @late(frozen=True)
    class Fresh:
        a: int

    bound = vars(Fresh)["__init__"].__get__(Fresh, type(Fresh))
    assert list(inspect.signature(bound).parameters) == ["a"]
    assert Fresh(1).a == 1
