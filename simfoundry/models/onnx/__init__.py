"""Models that run in this process on a CPU, from ONNX files."""
