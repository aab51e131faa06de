"""Gymnasium environments: any scene, one device or a batch."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from maglev_mj import Bias, Command, ExactPlant, ParameterError, Scene
from maglev_mj.interop import gym
from maglev_mj.spec import INERTIA


class Free(Scene):
    """A flotor whose weight is carried."""

    duration = 0.1

    def laws(self) -> list[Bias]:
        """Return the carried weight."""
        return [Bias((0.0, 0.0, INERTIA[0] * 9.81, 0.0, 0.0, 0.0))]


@pytest.mark.parametrize("scene", ["wall", "stick-slip"])
def test_every_scene_passes_the_check_and_a_batch_goes_as_one_device(scene: str) -> None:
    single = gymnasium.make("maglev_mj/Scene-v0", scene=scene, axes=["z", "rx"])
    check_env(single.unwrapped, skip_render_check=True)  # warnings are errors
    batch = gymnasium.make_vec("maglev_mj/Scene-v0", num_envs=3, scene=scene, axes=["z", "rx"])
    alone, of_all = single.reset(seed=5)[0], batch.reset(seed=5)[0]
    random = np.random.default_rng(0)
    for _ in range(1000):
        assert alone == pytest.approx(of_all[0], rel=1e-9, abs=1e-14) and of_all in batch.observation_space
        actions = random.uniform(-1.0, 1.0, (3, 2))
        alone, reward, _, over, _ = single.step(actions[0])
        of_all, rewards, ended, all_over, _ = batch.step(actions)
        assert reward == pytest.approx(rewards[0], rel=1e-9) and not ended.any() and (all_over == over).all()
        if over:
            break
    assert over and not (of_all[1:] == of_all[0]).all()
    following, rewards, _, all_over, _ = batch.step(actions)
    assert not rewards.any() and not all_over.any() and (following[:, :2] == following[0, :2]).all()
    assert (following[:, 4:] != of_all[:, 4:]).all()


def test_each_device_of_a_batch_has_its_own_seed() -> None:
    batch = gym.TargetVectorEnv(3)
    seeded = batch.reset(seed=[5, 7, 5])[0]
    for seed, observation in zip((5, 7, 5), seeded, strict=True):
        assert (gym.TargetEnv().reset(seed=seed)[0] == observation).all()
    assert (batch.reset()[0][0] != seeded[0]).any() and batch.reset(seed=5)[0].shape == seeded.shape
    with pytest.raises(ParameterError, match=r"seed must be an integer or one per device, 3 \(got 2\)"):
        batch.reset(seed=[1, 2])


def test_the_agents_force_is_that_of_the_plant_and_a_reward_that_of_the_distance() -> None:
    env = gym.TargetEnv(Free())
    observation, _ = env.reset(seed=1)
    target, start = observation[2], observation[0]
    drawn = np.random.default_rng(1).uniform(-1.0, 1.0, 2)
    disturbance = drawn[1] * 0.2 * 20.0
    assert target == pytest.approx(drawn[0] * 0.6 * 0.0045)
    with ExactPlant(gravity=9.81, wrench=[0.0] * 6) as plant:
        height = plant.read().position[2]
        for action in (1.0, -0.5, 0.25):
            plant.write(Command([0.0, 0.0, INERTIA[0] * 9.81 + 20.0 * action + disturbance, 0.0, 0.0, 0.0]))
            before, height = height, plant.read().position[2]
            observation, reward, *_ = env.step(np.array([action]))
            assert observation == pytest.approx([height, before, target], abs=1e-15)
            assert reward == pytest.approx(1.0 - abs(height - target) / 0.0045)
    assert start == 0.0


def test_a_flotor_beyond_its_range_is_seen_at_the_bound_until_the_end() -> None:
    env = gymnasium.make("maglev_mj/Joystick-v0", axes="z", wall=False)
    env.reset(seed=3)
    over, rewards, ended = False, [], False
    while not over:
        observation, reward, ended, over, _ = env.step(np.array([1.0]))
        rewards.append(reward)
    assert not ended and rewards[-1] == 0.0 and observation[0] == pytest.approx(0.009)


def test_a_batch_that_is_reset_at_its_end_goes_on_at_once() -> None:
    env, over = gym.TargetVectorEnv(2, "drop", duration=0.02), np.zeros(2, dtype=bool)
    env.reset(seed=1)
    while not over.any():
        _, _, _, over, _ = env.step(np.zeros((2, 1)))
    env.reset(seed=1)
    assert env.step(np.zeros((2, 1)))[1].any()  # a step that begins an episode has no reward


def test_a_scene_or_an_axis_that_is_not_there_is_refused() -> None:
    with pytest.raises(ParameterError, match="scene must be one of"):
        gymnasium.make("maglev_mj/Scene-v0", scene="nothing")
    with pytest.raises(ParameterError, match="axis must be"):
        gymnasium.make("maglev_mj/Joystick-v0", axes="w")
    with pytest.raises(ParameterError, match="plant must be one of mujoco"):
        gym.TargetEnv(type("Engine", (Free,), {"plants": ("mujoco",)})())
