"""Networks as ONNX files, which ONNX Runtime computes without torch (extra ``onnx``).

============  ==================================================================================
module        content
============  ==================================================================================
``graph``     `Graph`: operations, and the shapes of what they need
``encoding``  `encode_model`, `split_model`, `decode_tensors`: the format of ONNX, as far as our
              files need it
``session``   `OnnxSession`: the outputs of a file's graph by ONNX Runtime
============  ==================================================================================

No exporter traces the networks of torch. Our own graphs follow from the metadata alone, so that a
file is read only if it is byte for byte what `coopmap_agents.model_files` writes for its metadata
and weights. A file of others then has no other operations, loops or sizes, and names no other file.
Writing needs no package; torch's exporters need `onnx` (the deprecated one) or `onnxscript`.
"""
