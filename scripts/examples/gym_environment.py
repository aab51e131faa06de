"""Gymnasium environment: an agent moves the flotor to a target."""

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env

from maglev_mj.interop import gym  # registers the environments

ENVIRONMENT = {"id": "maglev_mj/Joystick-v0", "axes": "z"}


def spring_and_damper(observation):
    """Return the action of 5000 N/m and 100 N s/m."""
    position, before, target = np.split(observation, 3, axis=-1)
    force = 5000.0 * (target - position) - 100.0 * (position - before) / 0.005
    return np.clip(force / gym.FORCE, -1.0, 1.0)


if __name__ == "__main__":
    env = gymnasium.make(**ENVIRONMENT)
    check_env(env.unwrapped, skip_render_check=True)
    env.action_space.seed(0)
    for name, agent in {"random": lambda _: env.action_space.sample(), "PD": spring_and_damper}.items():
        observation, total, samples, over = env.reset(seed=9)[0], 0.0, 0, False
        while not over:
            observation, reward, _, over, _ = env.step(agent(observation))
            total, samples = total + reward, samples + 1
        print(
            f"{name}: reward {total:.0f} of {samples}, {1e3 * (observation[2] - observation[0]):+.2f} mm off the target"
        )
    many = gymnasium.make_vec(**ENVIRONMENT, num_envs=64)  # one batch
    observation, total = many.reset(seed=9)[0], 0.0
    for _ in range(samples):
        observation, reward, *_ = many.step(spring_and_damper(observation))
        total += reward
    print(f"PD on 64 devices: reward {total.min():.0f} to {total.max():.0f}")
