"""Reviewing labels: which are most probably wrong and why, what became of them, and what mending them was worth.

`doubts` asks networks that have not learnt from a label's scene how probably it is wrong; `queue` ranks labels by that
and other evidence; `items` says where a review stands, `worklist` what is shown next; `retraining` compares
networks learnt before and after.
"""
