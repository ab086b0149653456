"""Functions of arrays: counts, intervals, significance, calibration, kappa, splits. They know no files.

`relation_metrics` (relations that may hold together, and one relation a pair),
`calibration_metrics` (measured and fitted), and for how sure they are
`intervals` (clustered bootstrap, McNemar's exact test).
"""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.metrics.calibration_metrics import (
        ECE_BINS,
        IDENTITY,
        antisymmetric,
        antisymmetric_log_softmax,
        brier_score,
        expected_calibration_error,
        fit_calibration,
        fit_platt,
        fit_temperature,
        reliability_diagram,
        sigmoid,
        softmax,
    )
    from pipeline.metrics.intervals import (
        Agreement,
        BootstrapConfig,
        Estimate,
        bootstrap,
        cohen_kappa,
        f1_of,
        mcnemar,
        mean_estimate,
        mean_of_defined,
        ratio,
        share_estimate,
    )
    from pipeline.metrics.relation_metrics import (
        RelationMetrics,
        cell_outcomes,
        multi_label_metrics,
        relation_estimates,
        single_label_metrics,
        true_ranks,
        tuned_thresholds,
    )
    from pipeline.metrics.splits import DROPPED, TEST, TRAIN, VALIDATION, FrameKey, split_frames
    from pipeline.metrics.tables import Row, Table, as_csv, in_blocks, latex, markdown

__getattr__ = lazy_exports(__name__, __file__)
