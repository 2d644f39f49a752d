"""Behaviour cloning from a recorded dataset, as outside code would do it."""

import numpy as np
import pytest

from coopmap_env.evaluation.offline import record_dataset

pytest.importorskip("h5py")
torch = pytest.importorskip("torch")

N_ROBOTS, N_CANDIDATES = 2, 8


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    """Features (n, robots, m, 9), masks and choices of all recorded steps."""
    dataset = record_dataset(
        "rating_function",
        range(6),
        {
            "n_robots": N_ROBOTS, "max_scans": 8, "split": "train", "action_mode": "candidates",
            "n_candidates": N_CANDIDATES,
        },
        tmp_path_factory.mktemp("recorded"),
        progress=False,
    )  # fmt: skip
    shape = (-1, N_ROBOTS, N_CANDIDATES)

    def all_steps(key):
        return np.concatenate([episode.observations[key][:-1] for episode in dataset])

    candidates = torch.as_tensor(all_steps("candidates")).reshape(*shape, 9)
    mask = torch.as_tensor(all_steps("action_mask")).reshape(shape).bool()
    actions = torch.as_tensor(np.concatenate([episode.actions for episode in dataset]))
    return candidates, mask, actions


def test_a_clone_takes_the_recorded_actions_more_often_than_an_untrained_network(steps):
    candidates, mask, actions = steps
    assert mask.gather(2, actions[..., None]).all()  # no masked choice was taken
    torch.manual_seed(0)
    network = torch.nn.Sequential(torch.nn.Linear(9, 32), torch.nn.Tanh(), torch.nn.Linear(32, 1))
    optimizer = torch.optim.Adam(network.parameters(), 1e-2)

    def logits():
        return network(candidates)[..., 0].masked_fill(~mask, -1e9)

    def accuracy():
        return (logits().argmax(-1) == actions).float().mean().item()

    losses, untrained = [], accuracy()
    for _ in range(150):
        loss = torch.nn.functional.cross_entropy(logits().flatten(0, 1), actions.flatten())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.5 * losses[0]
    assert accuracy() > untrained + 0.3
