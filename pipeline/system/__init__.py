"""What every room stands on: errors, whole-file writing, jobs, plugins, the cache folder, ONNX sessions."""
