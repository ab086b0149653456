"""Frozen dataclasses whose functions are compiled when they are first called.

The standard library compiles six functions a class while a module is imported: half a millisecond each, a fifth of a
short command. Most classes of a command are never made.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from operator import attrgetter
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # Type checkers know the standard one; ours differs in nothing that they see.
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls: type | None = None, /, *, frozen: bool = False, eq: bool = True, **options: Any) -> Any:
        """Make a class a dataclass, as `dataclasses.dataclass` does; a frozen one at a twentieth of its cost.

        With options that change the class itself (`slots`, `order`), or not frozen, it is the standard library's.

        Examples
        --------
        >>> @dataclass(frozen=True)
        ... class Pixel:
        ...     u: int
        ...     v: int = 0
        >>> Pixel(3) == Pixel(u=3, v=0), Pixel(3)
        (True, Pixel(u=3, v=0))
        """

        def made(cls: type) -> type:
            if not frozen or options.keys() - {"kw_only"}:
                return dataclasses.dataclass(frozen=frozen, eq=eq, **options)(cls)
            own = dict(vars(cls))
            # Below a frozen class the standard library makes none that is not.
            below = any(dataclasses.is_dataclass(base) for base in cls.__bases__)
            dataclasses.dataclass(init=False, repr=False, eq=False, frozen=below, **options)(cls)
            cls.__dataclass_params__.frozen = True
            names = _FROZEN | (_COMPARED if eq else {})
            for name, function in names.items():
                # A class with an __eq__ of its own has None here.
                if own.get(name) is None:
                    setattr(cls, name, function)
            return cls

        return made if cls is None else made(cls)


class _Factory:
    """Default of a field that is made anew, as signatures show it."""

    def __repr__(self) -> str:
        return "<factory>"


class _Compiled:
    """Function of a class, made when it is first looked up; it then stands in its own place."""

    def __init__(self, name: str, make: Callable[[type], Callable[..., Any]]) -> None:
        self.name, self.make = name, make

    def __get__(self, instance: object, owner: type) -> Any:
        # From Python 3.13 on `inspect.signature` binds it as if the class were an instance of its metaclass.
        classes = (*owner.__mro__, *getattr(instance, "__mro__", ()))
        cls = next(one for one in classes if vars(one).get(self.name) is self)
        function = self.make(cls)
        function.__qualname__ = f"{cls.__qualname__}.{self.name}"
        function.__module__ = cls.__module__
        setattr(cls, self.name, function)
        return function.__get__(instance, owner)


def _init(cls: type) -> Callable[..., None]:
    """`__init__` with the fields of a class, in the standard library's order: those by keyword alone at the end."""
    taken: list[str] = []
    named: list[str] = []
    lines = ["pass"]
    scope: dict[str, Any] = {"_set": object.__setattr__, "_MADE": _Factory()}
    fields = dataclasses.fields(cls)  # pyright: ignore[reportArgumentType]
    for field in fields:
        name, value = field.name, field.name
        if field.default_factory is not dataclasses.MISSING:
            scope[f"_of_{name}"] = field.default_factory
            given = f"{name}=_MADE"
            value = f"_of_{name}() if {name} is _MADE else {name}" if field.init else f"_of_{name}()"
        elif field.default is not dataclasses.MISSING:
            scope[f"_of_{name}"] = field.default
            given = f"{name}=_of_{name}"
        else:
            given = name
        if field.init:
            (named if field.kw_only else taken).append(given)
        if field.init or field.default_factory is not dataclasses.MISSING:
            lines.append(f"_set(self, {name!r}, {value})")
    if hasattr(cls, "__post_init__"):
        lines.append("self.__post_init__()")
    heads = ", ".join(["self", *taken, *(["*", *named] if named else [])])
    exec(f"def __init__({heads}):\n " + "\n ".join(lines), scope)
    scope["__init__"].__annotations__ = {f.name: f.type for f in fields if f.init} | {"return": None}
    return scope["__init__"]


def _values(cls: type) -> Callable[[object], tuple[Any, ...]]:
    """Function of an instance: the values that are compared."""
    names = [field.name for field in dataclasses.fields(cls) if field.compare]  # pyright: ignore[reportArgumentType]
    if len(names) > 1:
        return attrgetter(*names)
    return lambda instance: tuple(getattr(instance, name) for name in names)


def _eq(cls: type) -> Callable[..., Any]:
    values = _values(cls)

    def __eq__(self: object, other: object) -> Any:
        return values(self) == values(other) if other.__class__ is self.__class__ else NotImplemented

    return __eq__


def _hash(cls: type) -> Callable[..., int]:
    values = _values(cls)

    def __hash__(self: object) -> int:
        return hash(values(self))

    return __hash__


@recursive_repr()
def _repr(self: Any) -> str:
    shown = (f"{field.name}={getattr(self, field.name)!r}" for field in dataclasses.fields(self) if field.repr)
    return f"{self.__class__.__qualname__}({', '.join(shown)})"


def _setattr(self: object, name: str, value: object) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


def _delattr(self: object, name: str) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")


_FROZEN: dict[str, Any] = {
    "__init__": _Compiled("__init__", _init),
    "__repr__": _repr,
    "__setattr__": _setattr,
    "__delattr__": _delattr,
}
_COMPARED: dict[str, Any] = {"__eq__": _Compiled("__eq__", _eq), "__hash__": _Compiled("__hash__", _hash)}
