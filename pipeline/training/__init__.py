"""The relation network made from labels or rendered rooms: data, fitting, cards."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.training.card import RoomConfig, write_onnx
    from pipeline.training.label_data import LabelData, pair_set, read_label_data
    from pipeline.training.label_training import LabelTraining, train_on_labels
    from pipeline.training.train import TrainConfig, require_training, train_pairs
    from pipeline.training.training_data import FrameSamples, degraded, make_samples

__getattr__ = lazy_exports(__name__, __file__)
