"""Functions of arrays: counts, intervals, significance, calibration, kappa, splits. They know no files."""
