"""A function over many items in a few threads: results in order, and an interrupt that is heeded at once."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def map_ordered(
    function: Callable[[Item, threading.Event], Result],
    items: Iterable[Item],
    workers: int,
    done: Callable[[int], None] = lambda _: None,
) -> list[Result]:
    """function(item, stop) of every item, in the order of the items.

    The threads are daemons, which the interpreter does not wait for when it ends: those of `concurrent.futures` would
    hold Ctrl-C up until the last answer comes.

    Parameters
    ----------
    function : callable
        Its second argument is set once nobody waits for results any more.
    items : iterable
        Taken one by one as workers come free, by one thread at a time.
    done : callable
        Called in the calling thread with the number of results so far.

    Raises
    ------
    Exception
        The first that a function, or the iteration, raises; what is not begun by then is not begun.
    """
    source, lock, stop = enumerate(items), threading.Lock(), threading.Event()
    results: queue.SimpleQueue[tuple[int, Result] | BaseException | None] = queue.SimpleQueue()

    def work() -> None:
        try:
            while not stop.is_set():
                with lock:
                    index, item = next(source, (-1, None))
                if index < 0:
                    break
                results.put((index, function(item, stop)))  # type: ignore[arg-type]
        except BaseException as error:
            results.put(error)
        else:
            results.put(None)

    found: dict[int, Result] = {}
    running = workers
    try:
        for _ in range(workers):
            threading.Thread(target=work, daemon=True).start()
        while running:
            try:
                # A wait without an end cannot be interrupted everywhere.
                result = results.get(timeout=0.5)
            except queue.Empty:
                continue
            if result is None:
                running -= 1
            elif isinstance(result, BaseException):
                raise result
            else:
                found[result[0]] = result[1]
                done(len(found))
    finally:
        stop.set()
    return [found[index] for index in range(len(found))]
