"""An episode of which a test says only what it depends on."""

from coopmap_env.evaluation import Episode, MappedExtent


def example_episode(seed=0, coverage_curve=(0.0, 0.1, 0.3), **fields):
    """Plausible values; `fields` replaces some of them."""
    values = {
        "entropy_curve": [3.0] * len(coverage_curve),
        "elapsed_curve": [2.0 * scan for scan in range(len(coverage_curve))],
        "max_time": None,
        "reward": 1.0,
        "motion_distance": 2.0,
        "log_loss": 0.1,
        "log_loss_free": 0.1,
        "log_loss_occupied": 0.1,
        "brier_score": 0.01,
        "extent": MappedExtent(9.0, 3.0, 1.0),
        "n_rejected_actions": 0,
        "n_collisions": 0,
        "planning_time_ms": 0.5,
    }
    return Episode(seed=seed, coverage_curve=list(coverage_curve), **{**values, **fields})
