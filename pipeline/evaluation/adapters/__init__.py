"""Files that other pipelines publish, turned into predictions as `docs/predictions.md` describes them."""

from pipeline.evaluation.adapters.base import PredictionFormat, Published
from pipeline.evaluation.adapters.converting import FORMATS, Converted, convert_predictions, import_published

__all__ = ["FORMATS", "Converted", "PredictionFormat", "Published", "convert_predictions", "import_published"]
