"""A minimum cut on a pixel grid: object or background, by evidence at each pixel and by links between neighbours."""

from __future__ import annotations

import numpy as np

NEIGHBOURS = (
    (np.s_[:, :-1], np.s_[:, 1:], 1.0),
    (np.s_[:-1], np.s_[1:], 1.0),
    (np.s_[:-1, :-1], np.s_[1:, 1:], 0.7),
    (np.s_[1:, :-1], np.s_[:-1, 1:], 0.7),
)
"""The 8-neighbourhood as pairs of views on a grid, with a link's weight by its length."""

_UNITS = 100
"""Capacities are whole numbers: this many for one unit of log-odds."""


def minimum_cut(log_odds: np.ndarray, links: list[np.ndarray]) -> np.ndarray:
    """The labelling of least energy (Boykov and Jolly 2001).

    Parameters
    ----------
    log_odds : (h, w) float
        Positive where a pixel by itself is of the object.
    links : list of four (h', w') float
        Cost of a border between neighbours, in the order of `NEIGHBOURS`.

    Returns
    -------
    (h, w) bool
        Of all best labellings the one with the fewest object pixels, so that the result is unique.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    n = log_odds.size
    nodes = np.arange(n)
    grid = nodes.reshape(log_odds.shape)
    a = np.concatenate([grid[first].ravel() for first, _, _ in NEIGHBOURS])
    b = np.concatenate([grid[second].ravel() for _, second, _ in NEIGHBOURS])
    link = np.concatenate([np.ravel(k) for k in links]) * _UNITS
    evidence = np.clip(log_odds.ravel(), -1e4, 1e4) * _UNITS
    source, sink = np.full(n, n), np.full(n, n + 1)
    capacity = np.concatenate([link, link, np.maximum(evidence, 0), np.maximum(-evidence, 0)]).astype(np.int32)
    rows, columns = np.concatenate([a, b, source, nodes]), np.concatenate([b, a, nodes, sink])
    graph = csr_matrix((capacity, (rows, columns)), shape=(n + 2, n + 2))
    residual = graph - maximum_flow(graph, n, n + 1).flow
    residual.data[residual.data < 0] = 0
    residual.eliminate_zeros()
    reached = np.zeros(n + 2, np.bool_)
    reached[breadth_first_order(residual, n, return_predecessors=False)] = True
    return reached[:n].reshape(log_odds.shape)
