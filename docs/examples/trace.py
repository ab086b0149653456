"""A pipeline of your own, traced as it runs: then one command says which of its modules failed.

    spatialviz import-run trace.jsonl --dataset demo --labels labels --out run

Its detector is the demo's annotations, of which it finds one of each name; its boxes are the spread of an object's
points; its relations compare centres.
"""

import numpy as np

import spatialviz as sp

AXES = {"left": (0, -1), "right": (0, 1), "above": (1, -1), "below": (1, 1)}  # Of the camera: x right, y down.


def box_of(frame: sp.Frame, mask: np.ndarray | None) -> dict[str, np.ndarray]:
    """Centre and size of the points of a mask, metres, in the camera frame."""
    assert mask is not None
    v, u = np.nonzero(mask & (frame.depth > 0))
    points = (np.linalg.inv(frame.camera.K) @ np.stack([u, v, np.ones(len(u))]) * frame.depth[v, u]).T
    low, high = np.percentile(points, [2, 98], axis=0)
    return {"center": (low + high) / 2, "size": high - low}


def main() -> None:
    labels = sp.label("demo", "labels", limit=1)
    frame = sp.open("demo").frames[0]
    with sp.trace("trace", system="centres", ranking="product") as t:
        for asked in labels.expressions.to_pylist():
            if asked["frame"] != frame.id or asked["relation"] not in AXES:
                continue
            target, relation, reference = asked["target"], asked["relation"], asked["reference"]
            t.expression(frame.id, asked["text"], target=target, relation=relation, reference=reference)
            boxes, ids = {}, {}
            for name in {target, reference}:
                seen = [a for a in frame.annotations if a.label == name and a.mask is not None][:1]
                ids[name] = t.proposals(name, [a.bbox for a in seen], [0.9] * len(seen), masks=[a.mask for a in seen])
                boxes |= {i: box_of(frame, a.mask) for i, a in zip(ids[name], seen, strict=True)}
            t.boxes(boxes)
            axis, sign = AXES[relation]
            ahead = {
                (a, b): sign * (boxes[a]["center"] - boxes[b]["center"])[axis]
                for a in ids[target]
                for b in ids[reference]
                if a != b
            }
            t.relations({relation: {pair: 1 / (1 + np.exp(-20 * metres)) for pair, metres in ahead.items()}})
            if ahead:
                t.answer(*max(ahead, key=lambda pair: ahead[pair]))
            else:
                t.answer(problem="no two things found")
    run = sp.import_records(t.path, "demo", "labels", "run", plots=False)
    print(run, run.verdicts, *run.failures()[:2], sep="\n")


if __name__ == "__main__":
    main()
