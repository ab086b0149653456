"""Foundation of all rooms: errors, safe files, whole-file writing, jobs, plugins, the cache folder, ONNX, chat."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.system.arrow import pa
    from pipeline.system.chat import ChatClient, ChatPicture, ChatQuestion
    from pipeline.system.detector_setup import DetectorSetup, named_model
    from pipeline.system.encoded_pictures import jpeg, png, resized, thumbnail
    from pipeline.system.errors import (
        FrameUnusable,
        InputError,
        MissingExtra,
        ServerError,
        UnknownClass,
        Unsupported,
        require,
    )
    from pipeline.system.execution import PROVIDER_VARIABLE, ProviderWarning, use_execution
    from pipeline.system.in_notebook import InNotebook
    from pipeline.system.limits import LIMITS_VARIABLE, current_limits, set_limits
    from pipeline.system.model_files import (
        HubId,
        KnownModel,
        all_fetched,
        fetched,
        known_models,
        parse_hub_id,
        resolve_model,
    )
    from pipeline.system.onnx_session import (
        file_hash,
        metadata,
        model_hash,
        open_session,
        run_session,
    )
    from pipeline.system.paths import asset_path
    from pipeline.system.plain_pickle import plain, read_plain_pickle
    from pipeline.system.whole_files import clear_abandoned, sha256_of, temporary_sibling
    from pipeline.system.worker_pool import SharedJob

__getattr__ = lazy_exports(__name__, __file__)
