"""An expression and a frame to ranked pairs: the opened pipeline, objects, the table of pairs, the answer."""
