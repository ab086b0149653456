"""Camera, frame, boxes, viewer axes, masks, and lifting: from a mask and depth to an oriented 3D box."""
