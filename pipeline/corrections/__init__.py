"""Correcting labels by hand, as a face does it: a desk for one person, and the labelled objects in 3D.

`desk` keeps what one person sees, saves, takes back and could not save yet,
`scene` makes objects of a frame's effective labels, `cards` says what is known
of a pair or an object, and where from.
"""
