"""Auditing benchmarks: which items' truth is probably wrong, with the evidence in words and figures.

`suspicion` holds an item, its evidence, how pieces of evidence are joined to one probability, and where runs agree with
each other against the truth; `sentences` compares what a sentence says with the annotated frame, as people's words see
it (`seen`); `benchmarks` and `statements` read and audit statements; `report` does it for whatever it is given, ranks
and writes.
"""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.audit.report import AuditReport

__getattr__ = lazy_exports(__name__, __file__)
