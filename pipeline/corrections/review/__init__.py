"""Reviewing labels: which are most probably wrong and why, what became of them, and what mending them was worth.

`out_of_fold` gives every relation label a probability by a network that has not
learnt from its scene; `confident` turns these into probabilities that labels are
wrong; `queue` ranks them together with other `evidence`; `items`, `reviewed` say
where a review stands; `retraining` compares networks learnt before and after.
"""
