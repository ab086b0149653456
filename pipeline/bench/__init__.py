"""Speed: every claim as a ratio beside its peer or floor, measured in one run."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.bench.claims import BenchRun, SpeedClaim
    from pipeline.bench.running import run_bench

__getattr__ = lazy_exports(__name__, __file__)
