"""Memory of recent values, by number and by weight."""

from __future__ import annotations

from pipeline.system.recent import Recent


def test_the_least_recently_used_makes_room() -> None:
    found: list[str] = []
    memory: Recent[str, str] = Recent(2)
    for key in "abacab":
        memory.get(key, lambda key=key: found.append(key) or key)
    assert found == ["a", "b", "c", "b"]


def test_weights_are_bounded_but_the_newest_stays() -> None:
    found: list[str] = []
    memory: Recent[str, str] = Recent(4, len)
    for key in ("aa", "bb", "aa", "c", "bb", "longer", "longer", "c", "bb"):
        memory.get(key, lambda key=key: found.append(key) or key)
    # "c" makes "bb" leave, "bb" makes "aa" leave, "longer" stays alone until the next.
    assert found == ["aa", "bb", "c", "bb", "longer", "c", "bb"]
