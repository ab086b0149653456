"""Voxels of a scene: which object was seen how often at which place.

The memory is that of the scene's surfaces, however many frames show them.
"""

from __future__ import annotations

import numpy as np

from pipeline.system.errors import require

VOXEL_M = 0.02
BACKGROUND = -1
"""Owner of places that belong to no object: walls, floors, and what nothing was found on."""
UNSEEN = -2
"""Owner of places that no view has measured."""
_BITS, _HALF = 21, 1 << 20
"""Bits of a coordinate; the scene may reach `_HALF` voxels (20 km at 2 cm) from the origin."""
_AROUND = np.array([(0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])


def keys_of(points: np.ndarray, side: float = VOXEL_M) -> np.ndarray:
    """Keys of the voxels that world points, (N, 3), metres, are in, (N,) int64; InputError beyond the reach of keys."""
    cell = np.floor(np.asarray(points, np.float64) / side)
    reach = float(np.abs(cell).max(initial=0.0))
    require(reach < _HALF - 1, "a point lies too far from the world's origin", got=f"{reach * side:.0f} m")
    return _packed(cell.astype(np.int64))


def centers_of(keys: np.ndarray, side: float = VOXEL_M) -> np.ndarray:
    """Centres of voxels by their keys, (N, 3) float64, metres."""
    mask = (1 << _BITS) - 1
    cell = np.stack([(keys >> (_BITS * k)) & mask for k in (2, 1, 0)], axis=-1) - _HALF
    return (cell + 0.5) * side


def _packed(cell: np.ndarray) -> np.ndarray:
    shifted = cell + _HALF
    return (shifted[..., 0] << (2 * _BITS)) | (shifted[..., 1] << _BITS) | shifted[..., 2]


class Voxels:
    """Counts of sightings by place and owner, an object's id or `BACKGROUND`.

    >>> import numpy as np
    >>> from pipeline.scenes.voxels import Voxels
    >>> voxels = Voxels()
    >>> voxels.add(np.array([[0.01, 0.01, 1.0]]), np.array([7]))
    >>> voxels.owners(np.array([[0.015, 0.005, 1.01], [2.0, 0.0, 0.0]])).tolist()
    [7, -2]
    """

    def __init__(self, side: float = VOXEL_M) -> None:
        self.side = side
        self._key = np.zeros(0, np.int64)
        self._owner = np.zeros(0, np.int32)
        self._count = np.zeros(0, np.int64)
        # By place, its most frequent owner; made when it is asked for
        self._best: tuple[np.ndarray, np.ndarray] | None = None

    def __len__(self) -> int:
        """Number of places."""
        return len(self._places()[0])

    def add(self, points: np.ndarray, owners: np.ndarray) -> None:
        """Count a view's world points, (N, 3), metres, of their owners, (N,) int; a place counts once a view."""
        pairs = np.unique(np.stack([keys_of(points, self.side), owners.astype(np.int64)]), axis=1)
        key = np.concatenate([self._key, pairs[0]])
        owner = np.concatenate([self._owner, pairs[1].astype(np.int32)])
        count = np.concatenate([self._count, np.ones(pairs.shape[1], np.int64)])
        self._set(key, owner, count)

    def _set(self, key: np.ndarray, owner: np.ndarray, count: np.ndarray) -> None:
        """Take counts, adding those of the same place and owner."""
        order = np.lexsort((owner, key))
        key, owner, count = key[order], owner[order], count[order]
        first = np.append(True, (np.diff(key) != 0) | (np.diff(owner) != 0))[: len(key)]
        starts = np.flatnonzero(first)
        self._key, self._owner = key[starts], owner[starts]
        self._count = np.add.reduceat(count, starts) if len(starts) else count
        self._best = None

    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Keys in order, and their most frequent owners; of equal ones the object before the background."""
        if self._best is None:
            order = np.lexsort((-self._owner, -self._count, self._key))
            key = self._key[order]
            first = np.flatnonzero(np.append(True, np.diff(key) != 0)) if len(key) else order
            self._best = key[first], self._owner[order][first]
        return self._best

    def owners(self, points: np.ndarray) -> np.ndarray:
        """Owners of the places of world points, (N,) int32: of the voxel itself, else of one that touches it."""
        keys, owners = self._places()
        found = np.full(len(points), UNSEEN, np.int32)
        if not len(keys):
            return found
        cell = np.floor(np.asarray(points, np.float64) / self.side).astype(np.int64)
        left = np.arange(len(points))
        for step in _AROUND:
            wanted = _packed(cell[left] + step)
            at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            hit = keys[at] == wanted
            found[left[hit]] = owners[at[hit]]
            left = left[~hit]
            if not len(left):
                break
        return found

    def of(self, owner: int, least: int = 1) -> np.ndarray:
        """Centres of the places of an owner, seen as its at least so often, (N, 3) float64, metres."""
        return centers_of(self._key[(self._owner == owner) & (self._count >= least)], self.side)

    def shared(self) -> dict[tuple[int, int], int]:
        """Number of places that two objects were both seen at, by their ids, the smaller first."""
        real = self._owner >= 0
        key, owner = self._key[real], self._owner[real]
        found: dict[tuple[int, int], int] = {}
        # Few places have more than two owners: pairs of neighbours in the order of keys are enough up to that many apart.
        for apart in range(1, 4):
            same = np.flatnonzero(key[apart:] == key[:-apart])
            pairs, counts = np.unique(np.stack([owner[same], owner[same + apart]]), axis=1, return_counts=True)
            for (a, b), n in zip(pairs.T.tolist(), counts.tolist(), strict=True):
                found[min(a, b), max(a, b)] = found.get((min(a, b), max(a, b)), 0) + n
        return found

    def sizes(self) -> dict[int, int]:
        """Number of places by owner."""
        owner, count = np.unique(self._owner, return_counts=True)
        return dict(zip(owner.tolist(), count.tolist(), strict=True))

    def renamed(self, new: dict[int, int]) -> None:
        """Give the places of owners to others: objects that turned out to be one."""
        table = {old: to for old, to in new.items() if old != to}
        if not table:
            return
        owner = self._owner.copy()
        for old, to in table.items():
            owner[self._owner == old] = to
        self._set(self._key, owner, self._count)
