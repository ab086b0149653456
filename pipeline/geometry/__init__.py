"""Camera, frame, boxes, viewer axes, masks, and lifting: from a mask and depth to an oriented 3D box."""

from pipeline.system.lazy_exports import lazy_exports

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pipeline.geometry.boxes import CORNER_SIGNS, EDGES, Box3D, iou_2d, iou_3d, paired_iou_2d
    from pipeline.geometry.camera import (
        CONVENTIONS,
        IMAGE_UP,
        STANDARD,
        Camera,
        backproject,
        check_convention,
        intrinsics,
        lift_pixels,
        project,
        standard_poses,
        to_world,
    )
    from pipeline.geometry.cleaning import LiftConfig, Pixel, clean, depth_edges
    from pipeline.geometry.cloud import Cloud, cloud_of, drawn_pixels, metre_grid, over_floor, viewpoint
    from pipeline.geometry.fitting import canonicalised, extents_of, pca_box
    from pipeline.geometry.frame import Annotation, Frame
    from pipeline.geometry.level_plane import MIN_SCORE, decided, far_from_level, level_normal_at, up_hypotheses
    from pipeline.geometry.lifting import LiftedObject, Quality, extents, lift
    from pipeline.geometry.masks import MaskCrop, RunLength, decode_crop, decode_run_length, encode_run_length
    from pipeline.geometry.palette import RGB, depth_colors, hex_color, ink, instance_colors
    from pipeline.geometry.picture_input import place_picture
    from pipeline.geometry.registration import Outlines, Registration, WarpEstimate, estimate_warp, registered
    from pipeline.geometry.surface import surface_normals
    from pipeline.geometry.viewer import ViewerAxes, resolve_up, viewer_axes

__getattr__ = lazy_exports(__name__, __file__)
