"""Cost of the observer of a flight in each sample, without a suspicion and while a probe runs.

`measure` is a section of bench.py: mean and 99 % of the processor time of a sample, with its part of the answer.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.observer import HandObserver
from maglev_mj.frames import ZERO, Command

SECONDS = 20.0


def times(rate: int, probing: bool, seconds: float) -> list[float]:
    """Return the processor time of each sample [s] of a flotor that trembles at 9 Hz with 0.1 mm."""
    calibration, period = Calibration.nominal(), 1.0 / rate
    observer = HandObserver(calibration, period, 0.3 * period)
    residual, weight, hover = observer.residual, (0.0 - calibration.body.load).tolist(), calibration.hover.tolist()
    found = []
    for tick in range(round(seconds * rate)):
        height = 1e-4 * np.sin(2.0 * np.pi * 9.0 * tick * period)
        residual.watching = True
        if probing and residual._signs is None:
            residual._begin()
        start = time.thread_time()
        observer.sampled(tick, 1, [0.0, 0.0, height, 0.0, 0.0, 0.0], tick - 1, 0.3 * period)
        residual.currents()
        observer.answered(tick, Command(weight), hover, None, 0.0, ZERO)
        found.append(time.thread_time() - start)
    return found


def measure(quick: bool) -> dict[str, Any]:
    """Return mean and 99 % of the processor time of a sample [µs]; quick for a test."""
    rows = {
        f"{rate} Hz{', while a probe runs' * probing}": times(rate, probing, 0.2 if quick else SECONDS)
        for rate in (200, 1000)
        for probing in (False, True)
    }
    return {
        "samples": {name: len(row) for name, row in rows.items()},
        "µs a sample": {name: 1e6 * float(np.mean(row)) for name, row in rows.items()},
        "µs, 99 %": {name: 1e6 * float(np.percentile(row, 99)) for name, row in rows.items()},
    }
