"""Scenes: one world over the posed frames of a recording.

Views of the same surfaces, agreement of their poses, world objects with one identity, and labels carried from frame to
frame. Above `answering`; nothing below knows of it.
"""
