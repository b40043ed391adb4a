"""Instance masks from ONNX segmentation exports or any callable."""
