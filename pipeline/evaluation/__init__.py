"""Evaluation: metrics as functions of arrays, the systems that are measured, and the run folder.

`relation_metrics` (relations that may hold together), `single_label_metrics`
(one relation a pair), `calibration_metrics`, `grounding_metrics`, and for how
sure they are `intervals`, `relation_intervals`, `grounding_intervals` (clustered
bootstrap) and `significance` (McNemar's exact test).

A figure without support is NaN and never 0: precision where nothing was said
to hold, recall, average precision and F1 where nothing holds; means go over
what is defined.
"""
