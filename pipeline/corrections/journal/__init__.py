"""Corrections: an append-only journal of what people changed in labels, and the labels that follow from it.

`journal` keeps events, `undo` takes back, `edits` makes what is to be saved,
`effective` applies events to the automatic labels, `materialise` writes the
result as an ordinary labels folder.
"""
