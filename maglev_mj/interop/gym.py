"""Gymnasium environments: an agent moves the flotor of a scene to a target.

Importing this module registers ``maglev_mj/Joystick-v0`` and ``maglev_mj/Scene-v0`` (any scene) with gymnasium.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TypeAlias

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from maglev_mj.errors import ParameterError
from maglev_mj.frames import ZERO, Array, components, join
from maglev_mj.parameters import axis_indices, numbers, whole
from maglev_mj.scenes.find import SceneLike, get_scene
from maglev_mj.scenes.run import checked_plant
from maglev_mj.scenes.stack import FAR, stacked_scenes

FORCE_SHARE = 3.0
"""Device's force limit over the maximum force of an agent on a translation: 20 N of 60 N."""

_DISTURBANCE, _TARGET = 0.2, 0.6

_Info: TypeAlias = dict[str, Any]


class TargetTask:
    """Task for one device or a batch: move the flotor of a scene to a target.

    The agent's wrench is added to that of the scene's laws and takes effect after the scene's delay. A constant
    disturbance of up to 0.2 of the agent's limit is added. The plant is the exact plant, without metal stops.

    Args:
        scene: See `maglev_mj.run`.
        axes: Names from AXES on which the agent acts; the scene's main axis by default.
        batch: () for one device, (N,) for N devices.
        parameters: Parameters of the scene.

    Attributes:
        action_space: Wrench of the agent relative to `limit`, in [-1, 1], one number per axis.
        observation_space: Position, previous position and target [m, rad], one number per axis each, clipped at twice
            the range of motion.
        limit: Maximum wrench of the agent [N, N m], (axes,): a third of the device's force limit on translations,
            scaled on rotations to cross the range in the same time.
        target: Target of the episode [m, rad], (..., axes), within 0.6 of the range.
        steps: Samples per episode, the duration of the scene.

    Raises:
        ParameterError: If there is no such scene, parameter or axis, or the scene does not support the exact plant.
    """

    def __init__(
        self,
        scene: SceneLike = "joystick",
        axes: str | Sequence[str] = "",
        batch: tuple[int, ...] = (),
        **parameters: Any,
    ) -> None:
        self.scene, self._batch = get_scene(scene).replace(**parameters), batch
        checked_plant(self.scene, "exact")
        self._axes = list(axis_indices(axes or self.scene.axis))
        body = self.scene.body.bounded
        limit = body.force_limit / FORCE_SHARE * body.inertia * body.range / (body.inertia[0] * body.range[0])
        self._reach, self.limit = body.range[self._axes], limit[self._axes]
        self.action_space = Box(-1.0, 1.0, (len(self._axes),), np.float64)
        high = np.tile(2.0 * self._reach, 3)
        self.observation_space = Box(-high, high, dtype=np.float64)
        self.steps = self.scene.ticks(self.scene.timing())

    def reset(self, *randoms: np.random.Generator) -> Array:
        """Draw targets and disturbances, by one generator or one per device; return the observation, (..., 3 axes)."""
        size = *self._batch[len(randoms) > 1 :], 2, len(self._axes)
        drawn = np.reshape([random.uniform(-1.0, 1.0, size) for random in randoms], (*self._batch, *size[-2:]))
        self.target, self._disturbance = _TARGET * drawn[..., 0, :] * self._reach, _DISTURBANCE * drawn[..., 1, :]
        source: Any = stacked_scenes([(self.scene, 0.0)] * self._batch[0]) if self._batch else self.scene
        self._plant = source.plant("exact", timing=self.scene.timing(), escape=FAR)
        self._controller = self.scene.controller()
        self._sample = self._plant.read()
        self._position = self._clipped_position()
        return self._observed(self._position)

    def step(self, action: Array) -> tuple[Array, Array, bool]:
        """Apply an action (..., axes) for one sample.

        Returns:
            Observation (..., 3 axes), reward (...,), and True at the end of the episode. The reward is 1 at the
            target, and falls linearly to 0 at a mean distance of the range of motion.

        Raises:
            ParameterError: If the action has another shape, or is not finite.
            DivergenceError: If unstable laws make numbers overflow.
        """
        action = numbers("action", action, shape=str((*self._batch, len(self._axes))))
        command, wrench = self._controller.step(self._sample), list(ZERO)
        for index, part in zip(self._axes, components(self.limit * (action + self._disturbance))):
            wrench[index] = part
        command.force = [law + agent for law, agent in zip(command.force, wrench)]
        self._plant.write(command)
        self._sample, before = self._plant.read(), self._position
        self._position = self._clipped_position()
        distance = np.abs(self.target - self._position) / self._reach
        reward = np.maximum(1.0 - distance.mean(axis=-1), 0.0)
        return self._observed(before), reward, self._sample.tick >= self.steps

    def _clipped_position(self) -> Array:
        """Return the clipped position along the agent's axes, (..., axes)."""
        position = np.broadcast_to(join(self._sample.position), (*self._batch, 6))[..., self._axes]
        return np.clip(position, -2.0 * self._reach, 2.0 * self._reach)

    def _observed(self, before: Array) -> Array:
        return np.concatenate([self._position, before, self.target], axis=-1)


class TargetEnv(gymnasium.Env[Array, Array]):
    """Environment of one device; see `TargetTask` for arguments, spaces and reward.

    Episodes are truncated, never terminated, as in dm_control.

    Args:
        scene: See `TargetTask`.
        axes: See `TargetTask`.
        render_mode: Ignored; some training programs always pass one.
        parameters: Parameters of the scene.

    Example:
        >>> import gymnasium, maglev_mj.interop.gym
        >>> env = gymnasium.make("maglev_mj/Scene-v0", scene="press", axes=["x", "z"])
        >>> env.action_space.shape, env.observation_space.shape
        ((2,), (6,))
    """

    def __init__(
        self,
        scene: SceneLike = "joystick",
        axes: str | Sequence[str] = "",
        render_mode: str | None = None,
        **parameters: Any,
    ) -> None:
        self.task = TargetTask(scene, axes, **parameters)
        self.action_space, self.observation_space = self.task.action_space, self.task.observation_space

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Array, _Info]:
        """Start an episode; the seed determines target and disturbance."""
        super().reset(seed=seed)
        return self.task.reset(self.np_random), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, _Info]:
        """See `TargetTask.step`."""
        observation, reward, over = self.task.step(action)
        return observation, float(reward), False, over, {}


class TargetVectorEnv(VectorEnv[Array, Array, Array]):
    """Environment of N devices in one batch; episodes end together, and the following step starts the next.

    Args:
        num_envs: Number of devices.
        scene: See `TargetTask`.
        axes: See `TargetTask`.
        parameters: Parameters of the scene.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # type: ignore[misc]

    def __init__(
        self, num_envs: int = 1, scene: SceneLike = "joystick", axes: str | Sequence[str] = "", **parameters: Any
    ) -> None:
        self.task, self.num_envs, self._over = TargetTask(scene, axes, (num_envs,), **parameters), num_envs, False
        self._randoms: list[np.random.Generator] = []
        self.single_action_space, self.single_observation_space = self.task.action_space, self.task.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Array, _Info]:
        """Start an episode of all devices; one seed, or one per device, determines targets and disturbances.

        A device with its own seed gets the episodes of a `TargetEnv` with that seed.

        Raises:
            ParameterError: If the number of seeds is not that of devices, or one is not an integer.
        """
        if isinstance(seed, Sequence | np.ndarray):
            if len(seed) != self.num_envs:
                raise ParameterError(f"seed must be an integer or one per device, {self.num_envs} (got {len(seed)})")
            self._randoms = [np_random(None if one is None else whole("seed", one))[0] for one in seed]
        else:
            super().reset(seed=seed)
            self._randoms = [self.np_random] if seed is not None or not self._randoms else self._randoms
        self._over = False
        return self.task.reset(*self._randoms), {}

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, _Info]:
        """See `TargetTask.step`; actions are (N, axes)."""
        never = np.zeros(self.num_envs, dtype=bool)
        if self._over:
            return self.reset()[0], np.zeros(self.num_envs), never, never, {}
        observation, reward, self._over = self.task.step(actions)
        return observation, reward, never, np.full(self.num_envs, self._over), {}


for _name in ("Joystick", "Scene"):  # the default scene is the joystick
    gymnasium.register(f"maglev_mj/{_name}-v0", entry_point=TargetEnv, vector_entry_point=TargetVectorEnv)
