"""BenchMARL on its own code: tasks of both worlds in both action modes, and our networks as models.

It needs an older TorchRL than the other tests: `make benchmarl` runs these in an environment of
their own.
"""

from dataclasses import dataclass

import pytest
import torch

pytest.importorskip("benchmarl")

from benchmarl.algorithms import IppoConfig, IqlConfig, MappoConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models import Model, ModelConfig
from plain.small_worlds import SETTINGS, masked_world, small_world
from torchrl.envs.utils import ExplorationType, check_env_specs, set_exploration_type

from coopmap_agents.benchmarl import CoopmapTask, CoopmapTaskClass, NetworkConfig, trained_network
from coopmap_agents.pretrained import LearnedPolicy, save_policy
from coopmap_env import families
from coopmap_env.envs import RejectedReason
from coopmap_env.envs.planar import PlanarEnv

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

GAMMA = 0.5
ALGORITHMS = {"MAPPO": MappoConfig, "IPPO": IppoConfig, "IQL": IqlConfig}
MODEL = NetworkConfig(hidden=(8, 8), image_features=8)
SMALL = {"settings": SETTINGS, "max_scans": 4}


class SmallWorld(CoopmapTaskClass):
    """Worlds in which a step takes a millisecond."""

    make = staticmethod(small_world)

    def _make(self, options):
        return self.make(**options)


class MaskedWorld(SmallWorld):
    make = staticmethod(masked_world)

    def _make(self, options):
        del options["action_mode"]
        return self.make(**options)


class Paid(PlanarEnv):
    def _assign_rewards(self, terms):
        return dict.fromkeys(self.agents, 1.0)


class PaidWorld(SmallWorld):
    """Pays each robot 1 a step."""

    make = Paid


@pytest.fixture
def experiment(tmp_path):
    made = []

    def make(
        task,
        algorithm="MAPPO",
        continuous=False,
        model=MODEL,
        critic=None,
        frames=32,
        n=2,
        tanh=True,
    ):
        config = ExperimentConfig.get_from_yaml()
        config.loggers, config.create_json, config.evaluation = [], False, False
        config.save_folder = str(tmp_path)
        config.gamma, config.prefer_continuous_actions = GAMMA, continuous
        config.on_policy_collected_frames_per_batch = frames
        config.on_policy_n_envs_per_worker = 2
        config.on_policy_minibatch_size, config.on_policy_n_minibatch_iters = frames, 1
        config.max_n_iters, config.max_n_frames = n, None
        algorithm_config = ALGORITHMS[algorithm].get_from_yaml()
        if algorithm != "IQL":
            algorithm_config.use_tanh_normal = tanh
        made.append(
            Experiment(
                task=task, algorithm_config=algorithm_config, model_config=model,
                critic_model_config=critic, seed=0, config=config,
            )
        )  # fmt: skip
        return made[-1]

    yield make
    for one in made:
        one.close()


def batches_of(one):
    """What an experiment collects, with the algorithm's values and advantages."""
    for played in one.collector:
        yield one.algorithm.process_batch("robot", played)


def batch_of(one):
    return next(batches_of(one))


@pytest.mark.parametrize("algorithm", ["MAPPO", "IPPO"])
@pytest.mark.parametrize("continuous", [True, False])
def test_a_training_runs_and_changes_the_weights(algorithm, continuous, experiment):
    one = experiment(SmallWorld("SMALL", {}), algorithm, continuous)
    before = [values.detach().clone() for values in one.policy.parameters()]
    one.run()
    assert one.n_iters_performed == 2
    after = list(one.policy.parameters())
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize("continuous", [True, False])
def test_the_field_runs(continuous, experiment):
    pytest.importorskip("pybullet")
    task = CoopmapTask.FIELD.get_task({"max_scans": 2, "n_candidates": 4})
    one = experiment(task, "MAPPO", continuous, frames=4)
    one.run()
    assert one.total_frames == 8


def test_what_is_collected_has_the_form_that_tasks_state():
    task = SmallWorld("SMALL", {})
    for continuous in (True, False):
        env = task.get_env_fun(1, continuous, 0, "cpu")()
        check_env_specs(env)
        assert task.max_steps(env) == 4
        assert task.group_map(env) == {"robot": ["robot_0", "robot_1"]}
        assert (task.action_mask_spec(env) is None) == continuous
        assert ("robot", "action_mask") in task.observation_spec(env).keys(True) or continuous
        assert set(task.info_spec(env)["robot", "info"].keys()) == {
            "observed_fraction",
            "rejected_reason",
        }
        env.close()


def test_members_are_the_worlds_and_all_families():
    names = {name.replace("-", "_").upper() for name in families.FAMILIES}
    assert {task.name for task in CoopmapTask} == {"PLANAR", "FIELD", *names}
    env = CoopmapTask.MOTION_BUDGET.get_task({"split": "validation"}).get_env_fun(
        1, False, 0, "cpu"
    )()
    assert env._env.split == "validation"
    env.close()


def test_the_action_mode_of_the_settings_decides():
    task = CoopmapTask.PLANAR.get_from_yaml()
    assert task.supports_continuous_actions()
    assert task.supports_discrete_actions()
    task = CoopmapTask.PLANAR.get_task({"action_mode": "candidates"})
    assert not task.supports_continuous_actions()
    assert task.supports_discrete_actions()
    assert not CoopmapTask.PLANAR.get_task({"action_mode": "pose"}).supports_discrete_actions()


class One(Model):
    """A critic with one number."""

    def __init__(self, **options):
        super().__init__(**options)
        self.value = torch.nn.Parameter(torch.zeros(1))

    def _perform_checks(self):
        pass

    def _forward(self, tensordict):
        rows = (tensordict["robot"] if self.output_has_agent_dim else tensordict).shape
        return tensordict.set(self.out_key, self.value.expand(*rows, 1))


@dataclass
class OneConfig(ModelConfig):
    @staticmethod
    def associated_class():
        return One


@pytest.mark.parametrize("algorithm", ["MAPPO", "IPPO"])
def test_a_constant_reward_is_worth_1_over_1_minus_gamma(algorithm, experiment):
    task = PaidWorld("PAID", SMALL)
    one = experiment(task, algorithm, critic=OneConfig(), n=12)
    (value,) = one.losses["robot"].critic_network_params.flatten_keys().values()
    for played in batches_of(one):
        ended = played["next", "done"].squeeze(-1)
        assert ended[:, 3].all()
        assert not ended[:, :3].any()
        value.data[:] = played["robot", "value_target"].mean()
    assert value.item() == pytest.approx(1 / (1 - GAMMA), rel=0.01)


@pytest.mark.parametrize("obeys", [True, False])
def test_no_masked_candidate_is_taken(obeys, experiment, monkeypatch):
    if not obeys:
        monkeypatch.setattr(CoopmapTaskClass, "action_mask_spec", lambda self, env: None)
        monkeypatch.setattr(NetworkConfig, "associated_class", staticmethod(lambda: Unmasked))
    played = batch_of(experiment(MaskedWorld("MASKED", {})))
    masked = played["next", "robot", "info", "rejected_reason"] == RejectedReason.MASKED
    assert bool(masked.any()) != obeys
    assert 0.05 < 1 - played["robot", "action_mask"].float().mean() < 1


class Unmasked(NetworkConfig.associated_class()):
    """The network without what it knows of the mask."""

    def _forward(self, tensordict):
        known = tensordict.get(("robot", "action_mask"))
        tensordict.set(("robot", "action_mask"), torch.ones_like(known))
        super()._forward(tensordict)
        return tensordict.set(("robot", "action_mask"), known)


def models(experiment, algorithm="MAPPO", continuous=False):
    one = experiment(SmallWorld("SMALL", {}), algorithm, continuous)
    with torch.no_grad():
        return one, batch_of(one)


def of_one_robot(played, robot):
    """Observations of a robot, as our networks take them."""
    parts = {**played["robot", "observation"]}
    if ("robot", "action_mask") in played.keys(True):
        parts["action_mask"] = played["robot", "action_mask"]
    return {key: values[:, :, robot].flatten(0, 1).float() for key, values in parts.items()}


def network_of(one, part):
    (found,) = [module for module in part.modules() if module.__class__.__name__ == "Network"]
    return found.networks[0]


@pytest.mark.parametrize("continuous", [True, False])
def test_the_actor_is_our_network(continuous, experiment):
    one, played = models(experiment, continuous=continuous)
    with torch.no_grad(), set_exploration_type(None):
        acted = one.policy(played.clone())
        for robot in range(2):
            ours = network_of(one, one.policy).get_distribution(of_one_robot(played, robot))
            theirs = acted["robot", "logits"][:, :, robot].flatten(0, 1)
            if continuous:
                mean, log_std = theirs.chunk(2, dim=-1)
                assert torch.allclose(mean, ours.distribution.mean, atol=1e-5)
                assert torch.allclose(log_std, torch.full_like(log_std, MODEL.log_std), atol=1e-5)
            else:
                assert torch.allclose(
                    theirs.log_softmax(-1).exp(), ours.distribution.probs, atol=1e-5
                )


@pytest.mark.parametrize(("algorithm", "central"), [("MAPPO", True), ("IPPO", False)])
@pytest.mark.parametrize("continuous", [True, False])
def test_central_critics_pool_over_robots(algorithm, central, continuous, experiment):
    one, played = models(experiment, algorithm, continuous)
    critic = one.losses["robot"].critic_network
    params = one.losses["robot"].critic_network_params

    def values(of):
        with torch.no_grad(), params.to_module(critic):
            return critic(of.clone())["robot", "state_value"]

    changed = played.clone()
    changed["robot", "observation", "pose"][:, :, 1] += 0.5
    difference = (values(changed) - values(played)).abs()
    assert (difference[:, :, 1] > 0).all()
    assert bool((difference[:, :, 0] > 0).all()) == central
    with torch.no_grad(), params.to_module(critic):
        ours = network_of(one, critic)
        inputs = [ours.critic_inputs(of_one_robot(played, robot)) for robot in range(2)]
        expected = ours.value_of(sum(inputs) / 2 if central else inputs[0])
    assert torch.allclose(values(played)[:, :, 0].flatten(0, 1), expected, atol=1e-5)


def test_robots_may_have_networks_of_their_own(experiment):
    task = SmallWorld("SMALL", {})
    one = experiment(task)
    one.config.share_policy_params = False
    again = Experiment(
        task=task, algorithm_config=one.algorithm_config, model_config=MODEL,
        seed=0, config=one.config,
    )  # fmt: skip
    (model,) = [m for m in again.policy.modules() if m.__class__.__name__ == "Network"]
    assert len(model.networks) == 2
    again.run()
    again.close()


def test_the_state_of_the_team_is_refused(experiment, monkeypatch):
    def state(self, env):
        from torchrl.data import Composite, Unbounded

        return Composite({"state": Unbounded((3,))})

    monkeypatch.setattr(CoopmapTaskClass, "state_spec", state)
    with pytest.raises(ValueError, match="observations of robots"):
        experiment(SmallWorld("SMALL", {}))


def test_logs_say_what_was_observed(experiment):
    one = experiment(SmallWorld("SMALL", {}))
    played = batch_of(one)
    logged = CoopmapTaskClass.log_info(played)
    ended = played["next", "done"].squeeze(-1)
    observed = played["next", "robot", "info", "observed_fraction"][ended]
    assert logged["coopmap/observed_fraction"] == pytest.approx(float(observed.mean()))
    reasons = played["next", "robot", "info", "rejected_reason"]
    assert logged["coopmap/rejected_fraction"] == pytest.approx(
        float((reasons != 0).float().mean())
    )
    assert "coopmap/observed_fraction" not in CoopmapTaskClass.log_info(played[:, :2])


def test_a_trained_actor_acts_the_same_from_a_file(experiment, tmp_path):
    one = experiment(SmallWorld("SMALL", {}))
    one.run()
    save_policy(*trained_network(one), tmp_path / "policy.safetensors")
    learned = LearnedPolicy(tmp_path / "policy.safetensors")
    wrapped = one.task.get_env_fun(1, False, 0, "cpu")()
    played, env = wrapped.reset(), wrapped._env
    for _ in range(4):
        parts = {**played["robot", "observation"], "action_mask": played["robot", "action_mask"]}
        rows = {key: values.numpy() for key, values in parts.items()}
        observed = [{key: values[robot] for key, values in rows.items()} for robot in range(2)]
        ours = learned.act(env.belief(), dict(zip(env.agents, observed, strict=True)))
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            played = one.policy(played)
        assert played["robot", "action"].tolist() == list(ours.values())
        played = wrapped.step(played)["next"]
    wrapped.close()


@pytest.mark.parametrize("tanh", [True, False])
def test_poses_of_another_distribution_are_not_written(tanh, experiment):
    one = experiment(SmallWorld("SMALL", {}), continuous=True, tanh=tanh)
    if tanh:
        with pytest.raises(ValueError, match="use_tanh_normal"):
            trained_network(one)
    else:
        network, settings = trained_network(one)
        assert network.log_std.tolist() == [settings.log_std] * 3


def test_algorithms_without_logits_are_refused(experiment):
    with pytest.raises(ValueError, match="logits or state_value"):
        experiment(SmallWorld("SMALL", {}), "IQL")
