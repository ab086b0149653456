"""Arrays of your own: a picture, a depth map, intrinsics and masks become a frame that can be asked, and looked at.

Run it with --show to open the page on the same arrays.
"""

import sys

import numpy as np

import spatialviz as sp

HEIGHT, WIDTH = 240, 320
K = np.array([[300.0, 0, 159.5], [0, 300, 119.5], [0, 0, 1]])


def scene() -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """A grey wall 2.5 m away, and before it two blocks: picture, depth in metres, masks by name."""
    rgb = np.full((HEIGHT, WIDTH, 3), 150, np.uint8)
    depth = np.full((HEIGHT, WIDTH), 2.5)
    masks = {}
    for name, rows, columns, metres, color in (
        ("cup", slice(110, 150), slice(70, 100), 1.5, (220, 90, 60)),
        ("box", slice(90, 160), slice(180, 260), 1.6, (60, 120, 210)),
    ):
        rgb[rows, columns], depth[rows, columns] = color, metres
        masks[name] = np.zeros((HEIGHT, WIDTH), bool)
        masks[name][rows, columns] = True
    return rgb, depth, masks


def main() -> None:
    rgb, depth, masks = scene()
    frame = sp.Frame.of_arrays(
        rgb, depth, K, masks=list(masks.values()), names=list(masks), up=(0, -1, 0), id="two blocks"
    )
    p = sp.open(frame)
    for question in ("cup left of the box", "cup right of the box"):
        answer = p.ask(0, question)
        print(f"{question}: {'yes' if answer.holds else 'no'}, {answer.relation_probability:.2f}")
    if "--show" in sys.argv:
        box = {"center": [-0.37, 0.05, 1.55], "size": [0.16, 0.2, 0.1]}  # Of the cup, by a module of your own;
        left = {(0, 1): 0.8}  # and P("cup left of box") by another: both are shown as they are.
        sp.show(
            rgb,
            depth,
            K,
            masks=list(masks.values()),
            names=list(masks),
            up=(0, -1, 0),
            boxes=[box, None],
            relations={"left": left},
        )


if __name__ == "__main__":
    main()
