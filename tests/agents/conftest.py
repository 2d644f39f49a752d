import pytest
import torch


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    """Small networks run no faster on more, and tests may run side by side."""
    torch.set_num_threads(1)
