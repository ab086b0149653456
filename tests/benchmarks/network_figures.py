"""The figures of a relation network, and of labels that it has a second opinion on, on rooms of other makers.

    cd tests && python -m benchmarks.network_figures [WORLDS] [NETWORK.onnx ...]

prints the tables of `assets/srm/README.md`: for each maker and each kind of camera so many worlds, with 95 % bootstrap
intervals over them; things of houses go by their own names, by each other's, by none.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from benchmarks.house_worlds import house_world
from box_worlds import box_world
from other_makers import FIGURES, FLIPS, REGIMES, Seen, figures, tallied, unnamed

from pipeline.labels.labelling import judge_objects, with_undecided
from pipeline.labels.plan import LabelConfig
from pipeline.labels.profiles import doubted
from pipeline.language.relation_names import DIRECTIONAL
from pipeline.metrics.intervals import bootstrap
from pipeline.relations import Appearance, shipped_network
from pipeline.relations.model import OnnxScorer
from pipeline.relations.relations import directional_states
from pipeline.relations.scorer import RuleScorer, rule_probabilities

FEWEST_OBJECTS = 5
WORLDS = 60
NAMES = ("true", "exchanged", "unknown")


def worlds(maker: str, regime: str, count: int) -> Iterator[Seen]:
    """Views with at least FEWEST_OBJECTS objects, out of so many worlds."""
    for seed in range(count):
        if maker == "boxes":
            objects, exact, viewer, *_ = box_world(seed, 400, 300, REGIMES[regime])
            found = Seen(objects, exact, viewer, unnamed(objects))
        else:
            found = house_world(seed, REGIMES[regime])
        if found is not None and len(found.objects) >= FEWEST_OBJECTS:
            yield found


def renamed(looks: Appearance, names: str, seed: int) -> Appearance:
    """The same things by the names of NAMES: exchanged, each goes by that of another thing of the view."""
    labels = looks.labels
    if names == "exchanged":
        order = np.random.default_rng([seed, 5]).permutation(len(labels))
        given = dict(zip(order.tolist(), np.roll(order, 1).tolist(), strict=True))
        labels = tuple(labels[given[k]] for k in range(len(labels)))
    return replace(looks, labels=("",) * len(labels) if names == "unknown" else labels)


def tallies(networks: Sequence[OnnxScorer], seen: Seen) -> list[np.ndarray]:
    """`tallied` of each network with labels that it has a second opinion on, and of the bare rule."""
    config = LabelConfig()
    lo, hi = (np.array([e[k] for e in seen.exact]) for k in (0, 1))
    truth = directional_states(lo, hi)
    rules = judge_objects(seen.objects, seen.viewer, config)
    rules = with_undecided(rules, np.array([o.quality.fallback for o in seen.objects], np.bool_))
    found = []
    for network in networks:
        labels = doubted(rules, network, seen.objects, seen.viewer, seen.looks).states[..., :6]
        found.append(tallied(network.of_pairs(seen.objects, seen.viewer, seen.looks), labels, truth))
    bare = rule_probabilities(RuleScorer().score(seen.objects, seen.viewer, relations=DIRECTIONAL).states)
    return [*found, tallied(bare, rules.states[..., :6], truth)]


def main(count: int, paths: Sequence[Path]) -> None:
    """Print the table."""
    networks = [OnnxScorer(path) for path in paths]
    print(f"| rooms | cameras | names | pairs | scorer | {' | '.join(FIGURES)} |")
    print("|---" * (5 + len(FIGURES)) + "|")
    for maker in ("boxes", "houses"):
        for regime in REGIMES:
            if maker == "boxes" and REGIMES[regime].close:
                continue
            seen = list(worlds(maker, regime, count))
            named = NAMES if maker == "houses" else NAMES[-1:]
            for names in named:
                shown = [replace(one, looks=renamed(one.looks, names, k)) for k, one in enumerate(seen)]
                rows = np.array([tallies(networks, one) for one in shown])
                rule = ["rule"] if names == named[0] else []
                for k, name in enumerate([*(path.stem for path in paths), *rule]):
                    found = bootstrap(rows[:, k], np.arange(len(rows)), figures)
                    cells = [e.formatted(1, 2 if what == FLIPS else 4) for what, e in zip(FIGURES, found, strict=True)]
                    pairs = f"{int(rows[:, k, 13].sum()):,}"
                    print("|", " | ".join([maker, regime, names, pairs, name, *cells]), "|", flush=True)


if __name__ == "__main__":
    given = sys.argv[1:]
    main(int(given[0]) if given else WORLDS, [Path(name) for name in given[1:]] or [shipped_network()])
