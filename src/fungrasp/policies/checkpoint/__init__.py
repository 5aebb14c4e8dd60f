"""The file of a learned policy: an ONNX graph and its card."""
