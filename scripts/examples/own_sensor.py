"""Own sensor: the mean of the last samples; its delay makes a stiff wall bounce.

A sensor has `start()`, which returns a function from the six true components to the six measured ones. It is called at
each sample, with floats for one device and with arrays for N.
"""

from dataclasses import dataclass

from maglev_mj import param, run_phases
from maglev_mj.scenes.drop import Drop


@dataclass(frozen=True)
class AveragingSensor:
    """Mean of the true pose over the last samples."""

    count: int

    def start(self):
        """Return the measuring function of one run."""
        kept = []

        def measure(position):
            kept.append(list(position))
            del kept[: -self.count]
            return [sum(parts) / len(kept) for parts in zip(*kept)]

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
