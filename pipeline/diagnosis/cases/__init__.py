"""Saved cases: a frame, its detections, an expression and the answer, as a folder to run again.

`saving` writes one and reads it back as a pipeline, `replay` runs it again and says what changed,
`manifest` and `kept` are its JSON files.
"""
