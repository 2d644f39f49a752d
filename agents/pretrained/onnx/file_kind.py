"""The files of policies, as `coopmap_agents.model_files` reads and writes them."""

from coopmap_agents.model_files import ModelKind
from coopmap_agents.pretrained.metadata import FORMAT, METADATA_KEY, PolicyMetadata
from coopmap_agents.pretrained.onnx.graph import policy_graph

POLICIES = ModelKind(
    name="policy",
    metadata_type=PolicyMetadata,
    metadata_key=METADATA_KEY,
    format=FORMAT,
    graph=policy_graph,
    command="coopmap train",
    function="save_policy",
)
