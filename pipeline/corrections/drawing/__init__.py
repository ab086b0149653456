"""Pixels by hand: strokes, polygons, rectangles and depth regions as masks.

`gestures` is what a hand has done, checked, and the exact masks that come of it;
`depth_region` grows over a surface from a click. Nothing here knows of labels.
"""
