"""Correcting labels by hand: an editor for one person, and the labelled objects in 3D.

`label_editor` keeps what one person sees, saves and takes back, `unsaved` what
could not be saved yet or is disputed, `journal_location` the journal that all
share. `scene` makes objects and cases of a frame's effective labels, `cards` and
`object_card` say what is known of a pair, an object or an expression, and where
from; `draft` and `support` are edits of pixels and of 3D boxes.
"""
