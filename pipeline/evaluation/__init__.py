"""Evaluation: metrics as functions of arrays, the systems that are measured, and the run folder.

`relation_metrics` (relations that may hold together), `single_label_metrics`
(one relation a pair), `calibration_metrics`, `grounding_metrics`, and for how
sure they are `intervals`, `relation_intervals`, `grounding_intervals` (clustered
bootstrap) and `significance` (McNemar's exact test).

A figure without a meaning is NaN and never 0: precision where nothing was said
to hold, recall and average precision where nothing holds, F1 where neither
(scikit-learn's zero_division=nan); means go over what is defined.
"""
