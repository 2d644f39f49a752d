"""Policies by ONNX Runtime, without torch: see `coopmap_agents.onnx` for their files.

============  ==================================================================================
module        content
============  ==================================================================================
``graph``     `policy_graph`: the operations of a policy, from its metadata
``network``   `OnnxNetwork`: decides by ONNX Runtime
============  ==================================================================================

After a change of the graph, `convert_policy` writes the files of pretrained policies again.
"""
