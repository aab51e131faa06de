"""Gymnasium environment: an agent moves the flotor to a target."""

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env

from maglev_mj.interop import gym

ENVIRONMENT, AXES = "maglev_mj/Joystick-v0", "z"  # registered by the import
LIMIT = gym.TargetTask("joystick", AXES).limit


def spring_and_damper(observation):
    """Return the action of 5000 N/m and 100 N s/m."""
    position, before, target = np.split(observation, 3, axis=-1)
    force = 5000.0 * (target - position) - 100.0 * (position - before) / 0.005
    return np.clip(force / LIMIT, -1.0, 1.0)


if __name__ == "__main__":
    env = gymnasium.make(ENVIRONMENT, axes=AXES)
    check_env(env.unwrapped, skip_render_check=True)
    env.action_space.seed(0)
    for name, agent in {"random": lambda _: env.action_space.sample(), "PD": spring_and_damper}.items():
        observation, rewards, ends = env.reset(seed=9)[0], [], [False]
        while not any(ends):
            observation, reward, *ends, _ = env.step(agent(observation))
            rewards.append(float(reward))
        off = 1e3 * (observation[2] - observation[0])
        print(f"{name}: reward {sum(rewards):.0f} of {len(rewards)}, {off:+.2f} mm off the target")
    many = gymnasium.make_vec(ENVIRONMENT, num_envs=64, axes=AXES)  # one batch
    states, totals = many.reset(seed=9)[0], np.zeros(64)
    for _step in rewards:
        states, gained = many.step(spring_and_damper(states))[:2]
        totals += gained
    print(f"PD on 64 devices: reward {totals.min():.0f} to {totals.max():.0f}")
