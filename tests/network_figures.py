"""The figures of a relation network, and of labels that it has a second opinion on, on rooms of other makers.

    python tests/network_figures.py [NETWORK.onnx] [WORLDS]

prints the table of `assets/srm/README.md`: for each maker and each kind of camera so many worlds, with 95 % bootstrap
intervals over them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from box_worlds import box_world
from mesh_worlds import mesh_world
from other_makers import FIGURES, FLIPS, REGIMES, Seen, figures, tallied

from pipeline.evaluation.intervals import bootstrap
from pipeline.labels.config import LabelConfig
from pipeline.labels.labelling import in_doubt, judge_objects
from pipeline.labels.second_opinion import doubted
from pipeline.relations import directional_states
from pipeline.srm import shipped_network
from pipeline.srm.model import OnnxScorer
from pipeline.srm.scorer import rule_probabilities

FEWEST_OBJECTS = 5
WORLDS = 100


def worlds(maker: str, regime: str, count: int) -> Iterator[Seen]:
    """Views with at least FEWEST_OBJECTS objects, out of so many worlds."""
    for seed in range(count):
        if maker == "boxes":
            found = Seen(*box_world(seed, 400, 300, REGIMES[regime])[:3])
        else:
            found = mesh_world(seed, REGIMES[regime])
        if found is not None and len(found.objects) >= FEWEST_OBJECTS:
            yield found


def tallies(network: OnnxScorer, seen: Seen) -> tuple[np.ndarray, np.ndarray]:
    """`tallied` of the network and of the rule, with the labels of either's second opinion."""
    config = LabelConfig()
    lo, hi = (np.array([e[k] for e in seen.exact]) for k in (0, 1))
    truth = directional_states(lo, hi)
    rules = judge_objects(seen.objects, seen.viewer, config)
    rules = in_doubt(rules, np.array([o.quality.fallback for o in seen.objects], np.bool_))
    labels = doubted(rules, network, seen.objects, seen.viewer).states[..., :6]
    seen_lo, seen_hi = (np.array([getattr(o, side) for o in seen.objects]) for side in ("lo", "hi"))
    bare = rule_probabilities(directional_states(seen_lo, seen_hi))
    return (
        tallied(network.of_pairs(seen.objects, seen.viewer), labels, truth),
        tallied(bare, rules.states[..., :6], truth),
    )


def main(path: Path, count: int) -> None:
    """Print the table."""
    network = OnnxScorer(path)
    print(f"| rooms | cameras | pairs | scorer | {' | '.join(FIGURES)} |")
    print("|---" * (4 + len(FIGURES)) + "|")
    for maker in ("boxes", "meshes"):
        for regime in REGIMES:
            if maker == "boxes" and REGIMES[regime].close:
                continue
            rows = [tallies(network, seen) for seen in worlds(maker, regime, count)]
            for k, name in enumerate((network.name, "rule")):
                sums = np.array([row[k] for row in rows])
                found = bootstrap(sums, np.arange(len(sums)), figures)
                cells = [e.formatted(1, 2 if what == FLIPS else 4) for what, e in zip(FIGURES, found, strict=True)]
                print(f"| {maker} | {regime} | {int(sums[:, 13].sum()):,} | {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    given = sys.argv[1:]
    main(Path(given[0]) if given else shipped_network(), int(given[1]) if len(given) > 1 else WORLDS)
