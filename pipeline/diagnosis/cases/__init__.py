"""Cases that are kept: a frame, its detections, an expression and the answer, as a folder that can be run again.

`saving` writes one and reads it back as a source, `replay` runs it again and says what changed,
`manifest` and `kept_proposals` are its two JSON files.
"""
