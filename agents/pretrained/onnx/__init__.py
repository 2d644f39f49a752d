"""Policies as ONNX files, which act by ONNX Runtime without torch (extra ``onnx``).

============  ==================================================================================
module        content
============  ==================================================================================
``graph``     `policy_graph`: the operations of a policy, from its metadata
``encoding``  `encode_model`, `split_model`, `decode_tensors`: the format of ONNX, as far as these
              files need it
``file``      `onnx_content`, `read_onnx`: graph, weights and metadata as a file
``network``   `OnnxNetwork`: decides by ONNX Runtime
============  ==================================================================================

No exporter traces the networks of torch. Our own graph follows from the metadata alone, so that a
file is read only if it is byte for byte what `onnx_content` writes for its metadata and weights. A
file of others then has no other operations, loops or sizes, and names no other file. After a change
of the graph, `convert_policy` writes the files of pretrained policies again. Writing needs no
package; torch's exporters need `onnx` (the deprecated one) or `onnxscript`.
"""
