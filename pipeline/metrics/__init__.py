"""Functions of arrays: counts, intervals, significance, calibration, kappa, splits. They know no files.

`relation_metrics` (relations that may hold together), `single_label_metrics`
(one relation a pair), `calibration_metrics`, and for how sure they are
`intervals` (clustered bootstrap) and `significance` (McNemar's exact test).
"""
