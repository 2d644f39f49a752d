import json
from dataclasses import replace

from coopmap_agents.config import EnvConfig, PPOSettings
from coopmap_env.studies import engine_comparison

TINY = PPOSettings(segment_steps=64, n_envs=2, rollout_steps=16, batch_size=32, n_epochs=2)


def test_the_summary_has_the_speed_of_both_engines_and_the_scores_of_each_seed(
    tmp_path, monkeypatch
):
    env = EnvConfig("planar", {"action_mode": "candidates", "n_candidates": 6, "max_scans": 4})
    monkeypatch.setattr(engine_comparison, "ENV", env)
    monkeypatch.setattr(engine_comparison, "VALIDATION_EPISODES", 2)
    settings = {"sb3": TINY, "ppo": replace(TINY, n_epochs=1)}
    monkeypatch.setattr(engine_comparison, "SETTINGS", settings)
    engine_comparison.main([str(tmp_path), "--seeds", "3", "4", "--total-steps", "64"])
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert all(speed > 0 for speed in summary["agent_steps_per_cpu_second"].values())
    for engine in ("sb3", "ppo"):
        assert set(summary[engine]) == {"3", "4"}
        record = json.loads((tmp_path / engine / "3" / "training.json").read_text())
        last = summary[engine]["3"]["last"]["coverage"]
        assert abs(last - record["rows"][-1]["validation"]["coverage"]) < 1e-4
