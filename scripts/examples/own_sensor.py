"""Own sensor: a moving average; its delay makes a stiff wall bounce.

A sensor has `start()`, which returns a function from the six true components to the six measured ones. It is called at
each sample, with floats for one device and with arrays for N.
"""

from dataclasses import dataclass

from maglev_mj import param, run_phases
from maglev_mj.scenes.drop import Drop


@dataclass(frozen=True)
class AveragingSensor:
    """Moving average of the true pose."""

    count: int

    def start(self):
        """Return the measuring function of one run."""
        window = []

        def measure(position):
            window.append(list(position))
            del window[: -self.count]
            return [sum(parts) / len(window) for parts in zip(*window)]

        return measure


class AveragedDrop(Drop):
    """Drop the flotor on a wall, measured by averages."""

    count: int = param("samples of an average", default=2, at_least=1, at_most=20)

    def plant_options(self):
        """Return the options of the drop, and the sensor."""
        return {**super().plant_options(), "sensor": AveragingSensor(self.count)}


if __name__ == "__main__":
    print("medians over 40 phases of the sampler")
    for count in (1, 2, 3):
        median = run_phases(AveragedDrop(count=count), 40, plant="exact").percentile(50.0)
        depth, rebound = 1e3 * median["penetration"], 1e3 * median["rebound"]
        print(f"mean of {count}: {depth:.2f} mm deep, rebounds {rebound:.2f} mm")
