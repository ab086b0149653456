"""Voxels of a scene: which object was seen how often at which place.

The memory is that of the scene's surfaces, however many frames show them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from functools import cached_property

import numpy as np

from pipeline.system.errors import require
from pipeline.system.frozen import dataclass

VOXEL_M = 0.02
BACKGROUND = -1
"""Owner of places that belong to no object: walls, floors, and what nothing was found on."""
UNSEEN = -2
"""Owner of places that no view has measured."""
_BITS, _HALF = 16, 1 << 15
"""Bits of a coordinate; the scene may reach `_HALF` voxels (655 m at 2 cm) from the world's origin."""
_OWNER_BITS = 15
MOST_OBJECTS = (1 << _OWNER_BITS) - 2
_AROUND = np.array([(0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])


def _cells(points: np.ndarray) -> np.ndarray:
    """Cells of world points, (N, 3) int64; InputError beyond the reach of keys."""
    cell = np.floor(np.asarray(points, np.float64) / VOXEL_M)
    reach = float(np.abs(cell).max(initial=0.0))
    require(reach < _HALF - 1, "a point lies too far from the world's origin", got=f"{reach * VOXEL_M:.0f} m")
    return cell.astype(np.int64)


def _keys(cell: np.ndarray) -> np.ndarray:
    shifted = cell + _HALF
    return (shifted[..., 0] << (2 * _BITS)) | (shifted[..., 1] << _BITS) | shifted[..., 2]


def centers_of(keys: np.ndarray) -> np.ndarray:
    """Centres of voxels by their keys, (N, 3) float64, metres."""
    cell = np.stack([(keys >> (_BITS * k)) & ((1 << _BITS) - 1) for k in (2, 1, 0)], axis=-1) - _HALF
    return (cell + 0.5) * VOXEL_M


@dataclass(frozen=True, eq=False)
class Voxels:
    """Counts of views by place and owner, an object's id or `BACKGROUND`.

    >>> import numpy as np
    >>> from pipeline.scenes.voxels import Voxels
    >>> voxels = Voxels().added(np.array([[0.01, 0.01, 1.0]]), np.array([7]))
    >>> voxels.owners(np.array([[0.015, 0.005, 1.01], [2.0, 0.0, 0.0]])).tolist()
    [7, -2]
    """

    pairs: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    """(N,) int64: the place's key, with the owner + 1 in the lowest bits, in order."""
    counts: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    """(N,) int32: views that saw the owner there."""

    def added(self, points: np.ndarray, owners: np.ndarray) -> Voxels:
        """Count a view's world points, (N, 3), metres, of their owners, (N,) int; a place counts once a view."""
        require(owners.max(initial=0) < MOST_OBJECTS, "a scene has too many objects", expected=f"up to {MOST_OBJECTS}")
        new = np.unique((_keys(_cells(points)) << _OWNER_BITS) | (owners.astype(np.int64) + 1))
        at = np.searchsorted(self.pairs, new)
        known = np.zeros(len(new), np.bool_)
        inside = at < len(self.pairs)
        known[inside] = self.pairs[at[inside]] == new[inside]
        counts = self.counts.copy()
        counts[at[known]] += 1
        return Voxels(np.insert(self.pairs, at[~known], new[~known]), np.insert(counts, at[~known], 1))

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Keys in order, (M,) int64, and their most frequent owners, (M,) int64; of equal ones the latest object."""
        key = self.pairs >> _OWNER_BITS
        starts = np.flatnonzero(np.diff(key, prepend=-1))
        ranked = (self.counts.astype(np.int64) << _OWNER_BITS) | self._owner_bits
        most = np.maximum.reduceat(ranked, starts) if len(starts) else ranked
        return key[starts], (most & MOST_OBJECTS + 1) - 1

    @property
    def _owner_bits(self) -> np.ndarray:
        return self.pairs & MOST_OBJECTS + 1

    def owners(self, points: np.ndarray) -> np.ndarray:
        """Owners of the places of world points, (N,) int64: of the voxel itself, else of one that touches it."""
        keys, owners = self.places
        found = np.full(len(points), UNSEEN, np.int64)
        if not len(keys):
            return found
        cell, left = _cells(points), np.arange(len(points))
        for step in _AROUND:
            wanted = _keys(cell[left] + step)
            at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            hit = keys[at] == wanted
            found[left[hit]] = owners[at[hit]]
            left = left[~hit]
        return found

    def of(self, owner: int, least: int = 1) -> np.ndarray:
        """Centres of the places of an owner, seen as its at least so often, (N, 3) float64, metres."""
        return centers_of(self.pairs[(self._owner_bits == owner + 1) & (self.counts >= least)] >> _OWNER_BITS)

    def sizes(self) -> dict[int, int]:
        """Number of places by owner."""
        owner, count = np.unique(self._owner_bits, return_counts=True)
        return dict(zip((owner - 1).tolist(), count.tolist(), strict=True))

    def shared(self) -> dict[tuple[int, int], int]:
        """Number of places that two objects were both seen at, by their ids, the smaller first."""
        pairs = self.pairs[self._owner_bits > 0]
        key, owner = pairs >> _OWNER_BITS, (pairs & MOST_OBJECTS + 1) - 1
        found: dict[tuple[int, int], int] = {}
        # Few places have more than four owners: neighbours up to so many apart in the order are enough.
        for apart in range(1, 4):
            same = np.flatnonzero(key[apart:] == key[:-apart])
            both, counts = np.unique(np.stack([owner[same], owner[same + apart]]), axis=1, return_counts=True)
            for (a, b), n in zip(both.T.tolist(), counts.tolist(), strict=True):
                found[a, b] = found.get((a, b), 0) + n
        return found

    def renamed(self, new: Mapping[int, int]) -> Voxels:
        """Voxels with other ids of their owners, by the old ones: objects that turned out to be one."""
        owner = self._owner_bits
        table = np.arange(int(owner.max(initial=0)) + 1)
        for old, to in new.items():
            table[old + 1 : old + 2] = to + 1
        pairs = (self.pairs & ~np.int64(MOST_OBJECTS + 1)) | table[owner]
        order = np.argsort(pairs, kind="stable")
        pairs, counts = pairs[order], self.counts[order]
        starts = np.flatnonzero(np.diff(pairs, prepend=-1))
        return Voxels(pairs[starts], np.add.reduceat(counts, starts) if len(starts) else counts)
