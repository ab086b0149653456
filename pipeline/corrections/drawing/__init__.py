"""Pixels by hand: strokes, polygons, rectangles and depth regions as masks, and masks cut in parts.

`gestures` is what a hand has done, checked, and the masks that come of it;
`strokes` are exact shapes of pixels, `depth_region` grows over a surface from a
click, `splitting` cuts a mask. Nothing here knows of labels.
"""
