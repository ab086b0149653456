"""SQLite's write-ahead log, checked before SQLite reads it, which drops all after a broken frame and says nothing.

The format is that of sqlite.org/walformat.html, the checksum that of its section 4.2.
"""

from __future__ import annotations

import time
from functools import lru_cache
from pathlib import Path

import numpy as np

_HEADER, _FRAME, _INDEX = 32, 24, 48
_MAGIC = 0x377F0682
_TRIES, _PAUSE_S = 20, 0.05


def lost_in_log(path: Path) -> str | None:
    """What was saved into a journal's log and cannot be read back from it, in a clause; None where there is nothing.

    Others may write while it is read: what was only half written then is there on another try.

    Parameters
    ----------
    path : Path
        Of the journal.
    """
    found, seen = None, b""
    for _ in range(_TRIES):
        # The index first: what it says was saved is in a log that is read after it.
        index, log = _bytes(Path(f"{path}-shm")), _bytes(Path(f"{path}-wal"))
        found = _lost(log, index)
        if found is None or log == seen:
            return found
        seen = log
        time.sleep(_PAUSE_S)
    return found


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""


def _lost(log: bytes, index: bytes) -> str | None:
    if len(log) <= _HEADER:
        return None
    head = np.frombuffer(log[:_HEADER], ">u4")
    size = int(head[2])
    order = ">u4" if int(head[0]) & 1 else "<u4"
    words = np.frombuffer(log[:24], order).astype(np.uint32)[None]
    sound = int(head[0]) & ~1 == _MAGIC and 512 <= size <= 65_536 and size & (size - 1) == 0
    if not sound or (_sums(words)[0] != head[6:]).any():
        return "the head of the write-ahead log cannot be read"
    count = (len(log) - _HEADER) // (_FRAME + size)
    frames = np.frombuffer(log, np.uint8, count * (_FRAME + size), _HEADER).reshape(count, _FRAME + size)
    heads = frames[:, :_FRAME].copy().view(">u4").reshape(count, 6)
    # What is left from an earlier turn of the log has other salts, both of them; nothing but damage makes zeros.
    salts = heads[:, 2:4] == head[4:6]
    ends = np.flatnonzero((salts.any(axis=1) & (heads[:, 1] > 0)) | (heads == 0).all(axis=1))
    content = np.concatenate([frames[:, :8], frames[:, _FRAME:]], axis=1)
    before = np.concatenate([head[None, 6:], heads[:-1, 4:]])
    whole = salts.all(axis=1) & (_sums(content.view(order).astype(np.uint32), before) == heads[:, 4:]).all(axis=1)
    valid = count if whole.all() else int(np.argmin(whole))
    saved = _frames_saved(index, log[16:24])
    if saved is None:
        # A process that is killed while it writes its last frame leaves the same as damage to that frame does.
        return f"the write-ahead log is broken at frame {valid + 1}" if ends.size and ends[-1] >= valid else None
    known = int(ends[ends < valid][-1]) + 1 if (ends < valid).any() else 0
    return f"the write-ahead log is broken at frame {valid + 1} of {saved}" if known < saved else None


def _frames_saved(index: bytes, salt: bytes) -> int | None:
    """How many frames the log's index says are saved; None where it is of another log, or cannot be read."""
    if len(index) < 2 * _INDEX:
        return None
    words = np.frombuffer(index[:_INDEX], np.uint32)
    sound = index[:_INDEX] == index[_INDEX : 2 * _INDEX] and index[32:40] == salt
    return int(words[4]) if sound and (_sums(words[None, :10])[0] == words[10:]).all() else None


def _sums(words: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
    """Checksums of rows of 32-bit words: (N, 2), from those (N, 2) before them.

    A step is s' = M s + B w, modulo 2^32; so all of a row's are one product.
    """
    start, terms = _weights(words.shape[1])
    found = np.stack([(words * terms[k]).sum(axis=1, dtype=np.uint32) for k in (0, 1)], axis=1)
    if before is None:
        return found
    seeds = before.astype(np.uint32)
    return found + np.stack([(seeds * start[k]).sum(axis=1, dtype=np.uint32) for k in (0, 1)], axis=1)


@lru_cache
def _weights(length: int) -> tuple[np.ndarray, np.ndarray]:
    """What the sums before (2, 2) and each word (2, length) count for in the sums after."""
    limit = 1 << 32
    terms = np.zeros((2, length), np.uint32)
    # For each pair of words: s0 += w0 + s1, s1 += w1 + s0. `power` is what the sums after a pair count for at the end.
    power = [[1, 0], [0, 1]]
    for k in range(length - 2, -1, -2):
        for row in (0, 1):
            a, b = power[row]
            terms[row, k], terms[row, k + 1] = (a + b) % limit, b
            power[row] = [(a + b) % limit, (a + 2 * b) % limit]
    return np.array(power, np.uint32), terms
