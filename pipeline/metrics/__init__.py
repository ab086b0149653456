"""Functions of arrays: counts, intervals, significance, calibration, kappa, splits. They know no files.

`relation_metrics` (relations that may hold together, and one relation a pair),
`calibration_metrics` (measured and fitted), and for how sure they are
`intervals` (clustered bootstrap, McNemar's exact test).
"""
