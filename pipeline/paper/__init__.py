"""The paper's rows: systems that its own is compared with, its tables with the published figures, the ablation."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.paper.ablation import AblationConfig
    from pipeline.paper.systems import Referring, Vlm, recorded_system
    from pipeline.paper.tables import tables_of_folder, tables_of_run

__getattr__ = lazy_exports(__name__, __file__)
