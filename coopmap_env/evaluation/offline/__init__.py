"""Recorded episodes for offline learning, in the files of Minari; ``coopmap record`` writes them.

A dataset is a folder with ``data/main_data.hdf5`` (arrays) and ``data/metadata.json``. It has no
code and no pickles. `minari.MinariDataset(folder / "data")` reads it, and so does
`RecordedDataset`, which needs no Minari and trusts no file.

==================  ============================================================================
`record_dataset`    play a policy on many worlds and write the dataset
`RecordedDataset`   read one: a sequence of `RecordedEpisode`
`record_episode`    one episode, in memory
==================  ============================================================================
"""

from coopmap_env.evaluation.offline.dataset import RecordedDataset, RecordingError
from coopmap_env.evaluation.offline.episode import RecordedEpisode, record_episode
from coopmap_env.evaluation.offline.jobs import default_dataset_id, record_dataset

__all__ = [
    "RecordedDataset",
    "RecordedEpisode",
    "RecordingError",
    "default_dataset_id",
    "record_dataset",
    "record_episode",
]
