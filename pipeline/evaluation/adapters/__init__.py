"""Files that other pipelines publish, turned into predictions as `docs/predictions.md` describes them."""

from pipeline.evaluation.adapters.converting import Converted, convert_predictions, import_published
from pipeline.evaluation.adapters.formats import FORMATS
from pipeline.evaluation.adapters.published import PredictionFormat, Published

__all__ = ["FORMATS", "Converted", "PredictionFormat", "Published", "convert_predictions", "import_published"]
