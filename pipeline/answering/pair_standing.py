"""Standing of the target, the reference and the relation of a pair among the other pairs of its line.

Many rankings go by no factor alone: by the rank of a thing, by a softmax over the references of a target, by how far
the best is before the next, by values brought between 0 and 1 within the line. Each column here is one such view; none
is less where a factor of the pair itself is more.
"""

from __future__ import annotations

import numpy as np

_FIRST = (1, 2, 3, 5)
_STEEP = 4.0
"""Of a softmax over values from 0 to 1, so many times."""
_EVEN = 0.01
"""No spread within a line counts as less."""
_FAR = 5.0


def standing(factors: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """(..., P, K) float64 of the factors (..., P, 3) of the P pairs of a line with these ids (P, 2).

    Of target, reference and relation the share that is not surer, whether among the first few, and how many pairs it is
    above; `_shares`; the place between the least and the most of the line, and from the mean in standard deviations.
    Objects not proposed (an id below 0) are no rivals.
    """
    lines = factors.reshape(int(np.prod(factors.shape[:-2])), *factors.shape[-2:])
    found, known = [], ids.min(axis=1) >= 0
    for part in range(3):
        numbers = np.arange(len(ids)) if part == 2 else ids[:, part]
        _, first, own = np.unique(numbers, return_index=True, return_inverse=True)
        rivals = first[ids[first].min(axis=1) >= 0] if part == 2 else first[numbers[first] >= 0]
        values = -lines[:, :, part]
        above = [np.searchsorted(np.sort(v[rivals]), v[first], side="left")[own.ravel()] for v in values]
        rank = np.array(above).reshape(lines.shape[:2])
        found += [1 - rank / max(len(rivals), 1), *(rank < k for k in _FIRST)]
        found += [[np.searchsorted(np.sort(v[known]), v, side="left") for v in -values]]
    clear = np.clip(lines, 0.01, 0.99)
    found += _shares(clear, ids, known)
    if known.any():
        for v in np.moveaxis(clear, -1, 0):
            among = v[:, known]
            low, high, mean, std = (f(axis=1, keepdims=True) for f in (among.min, among.max, among.mean, among.std))
            found += [np.clip((v - low) / np.maximum(high - low, _EVEN), 0, 1)]
            found += [np.clip((v - mean) / np.maximum(std, _EVEN), -_FAR, _FAR)]
    else:
        found += [np.zeros(clear.shape[:2])] * 6
    told = np.stack([np.asarray(f) for f in found], axis=-1).astype(np.float64)
    return told.reshape(*factors.shape[:-1], len(found))


def _shares(clear: np.ndarray, ids: np.ndarray, known: np.ndarray) -> list[np.ndarray]:
    """(L, P) float64 each, of lines (L, P, 3), among the pairs of the target, of the reference, and all.

    Share of a pair in its like, in logarithms and by itself, whether first, the distance to the best of the others (as
    a share of the more), the first and the mean of them. Then the less of its shares among those of its target and of
    its reference.
    """
    t, r, p = np.moveaxis(clear, -1, 0)
    odds, steep, whole = p / (1 - p), np.exp(_STEEP * p), t * r * p
    groups = (
        (ids[:, 0], (p, whole, odds, r * p, r * steep)),
        (ids[:, 1], (p, whole, odds, t * p, t * steep)),
        (np.zeros(len(ids)), (p, whole, t, r)),
    )
    found = [[_share(v, numbers, known) for v in values] for numbers, values in groups]
    less = [np.minimum(one[0], other[0]) for one, other in zip(*found[:2], strict=True)][:2]
    return [column for values in found for columns in values for column in columns] + less


def _share(v: np.ndarray, numbers: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, ...]:
    """Six views (L, P) of values (L, P) above 0 among those of the pairs with equal number (P,)."""
    others, best, count = np.zeros_like(v), np.zeros_like(v), np.zeros(len(numbers))
    for number in np.unique(numbers):
        group = numbers == number
        rivals = group & known
        among = np.sort(np.concatenate([np.zeros((len(v), 2)), v[:, rivals]], axis=1), axis=1)
        own = known[group]
        others[:, group] = among.sum(axis=1, keepdims=True) - v[:, group] * own
        # The best of the others is the second for a pair that is itself the first.
        best[:, group] = np.where(own & (v[:, group] == among[:, -1:]), among[:, -2:-1], among[:, -1:])
        count[group] = rivals.sum() - own
    share = v / (v + others)
    first = np.maximum(v, best)
    return np.log(share), share, v >= best, (v - best) / first, first, (v + others) / (1 + count)
