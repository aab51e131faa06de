"""PPO of Stable-Baselines3 learns the task of gym_environment.py, on the exact plant, in about a minute.

pip install stable-baselines3 && python scripts/examples/ppo.py [SEED]
"""

import sys

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from gym_environment import AXES, ENVIRONMENT, spring_and_damper

GAMMA = 0.95  # horizon of 0.1 s, longer than the flotor needs to cross its range


def score(name, agent):
    """Print reward and distance over 64 unseen targets."""
    many, rewards, distances, over = gymnasium.make_vec(ENVIRONMENT, num_envs=64, axes=AXES), [], [], [False]
    states, _ = many.reset(seed=1000)
    while not any(over):
        states, gained, _, over, _ = many.step(agent(states))
        rewards.append(gained)
        distances.append(np.abs(states[:, 2] - states[:, 0]))
    print(f"{name}: mean reward {np.mean(rewards):.2f}, {1e3 * np.mean(distances):.2f} mm from the target")


if __name__ == "__main__":
    seed, random = int((sys.argv[1:] or ["0"])[0]), np.random.default_rng(0)
    env = VecNormalize(make_vec_env(ENVIRONMENT, 8, seed, env_kwargs={"axes": AXES, "render_mode": None}), gamma=GAMMA)
    settings = {"n_steps": 256, "batch_size": 128, "gamma": GAMMA, "learning_rate": 1e-3, "device": "cpu", "seed": seed}
    model = PPO("MlpPolicy", env, policy_kwargs={"log_std_init": -1.0}, **settings)
    score("random", lambda states: random.uniform(-1.0, 1.0, (len(states), 1)))
    score("PD", spring_and_damper)
    for name, steps in {"PPO before": 0, "PPO after": 200_000}.items():
        model.learn(steps)
        score(name, lambda states: model.predict(env.normalize_obs(states), deterministic=True)[0])
