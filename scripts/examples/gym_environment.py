"""Gymnasium environment: an agent moves the flotor to a target."""

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env

from maglev_mj import Command, ExactPlant, Timing
from maglev_mj.spec import RANGE

FORCE, PUSH, REACH, SAMPLES = 20.0, 4.0, RANGE[2], 200


class TargetEnv(gymnasium.Env):
    """Move the flotor to a target.

    All acts along z; the weight is carried; the seed draws the target and a hand's push. Action (1,): force as a share
    of 20 N. Observation (3,): height, height one sample before, target [m]. Reward of a sample: 1 on the target, 0 at
    9 mm from it. An episode terminates 4.5 mm off the centre and is truncated after 1 s.
    """

    action_space = Box(-1.0, 1.0, (1,), np.float64)
    observation_space = Box(-10.0 * REACH, 10.0 * REACH, (3,), np.float64)

    def reset(self, *, seed=None, options=None):
        """Start at rest in the centre."""
        super().reset(seed=seed)
        push, self.target = self.np_random.uniform(-1.0, 1.0, 2) * (PUSH, 0.6 * REACH)
        self.plant = ExactPlant(Timing(), gravity=0.0, hand_force=lambda *_: [0.0, 0.0, push, 0.0, 0.0, 0.0])
        self.height = self.plant.read().position[2]
        return np.array([self.height, self.height, self.target]), {}

    def step(self, action):
        """Hold a force until the next sample."""
        self.plant.write(Command([0.0, 0.0, FORCE * float(action[0]), 0.0, 0.0, 0.0]))
        sample, before = self.plant.read(), self.height
        self.height = sample.position[2]
        reward = max(1.0 - abs(self.target - self.height) / (2.0 * REACH), 0.0)
        observation = np.array([self.height, before, self.target])
        return observation, reward, abs(self.height) > REACH, sample.tick >= SAMPLES, {}


def spring_and_damper(observation):
    """Return the action of 2000 N/m and 60 N s/m."""
    height, before, target = observation
    force = 2000.0 * (target - height) - 60.0 * (height - before) / Timing().period
    return np.clip([force / FORCE], -1.0, 1.0)


if __name__ == "__main__":
    check_env(env := TargetEnv(), skip_render_check=True)
    env.action_space.seed(0)
    for name, agent in {"random": lambda _: env.action_space.sample(), "PD": spring_and_damper}.items():
        observation, total, ends = env.reset(seed=1)[0], 0.0, [False]
        while not any(ends):
            observation, reward, *ends, _ = env.step(agent(observation))
            total += reward
        print(f"{name}: reward {total:.0f} of {SAMPLES}, {1e3 * (env.target - env.height):+.2f} mm off the target")
