"""Own study on Dask: the click of a button.

It varies the button's stiffness and the sample rate.

    python scripts/examples/own_study.py [tcp://SCHEDULER:8786]

Without an address it starts a worker here. Dask sends the function; its module `own_law.py`, which workers do not
have, is named in `files`. They need this package alone.
"""

import sys
from pathlib import Path

import numpy as np
from distributed import LocalCluster

from maglev_mj import Timing, dask_workers, run_cells
from own_law import Button, press

RATES, STIFFNESSES = (200.0, 500.0, 1000.0), (2000.0, 3000.0, 4000.0)


def clicks(cells):
    """Return the force lost in the click, by cell [N]."""
    losses = []
    for cell in cells:
        period = 1.0 / cell["rate"]
        _, force = press(Button(axes="z", stiffness=cell["stiffness"]), Timing(period=period, delay=0.3 * period))
        losses.append(float(-np.diff(force).min()))
    return losses


def main(address):
    """Run the study and print its table."""
    cells = [{"rate": rate, "stiffness": stiffness} for rate in RATES for stiffness in STIFFNESSES]
    workers = dask_workers(address, files=Path(__file__).with_name("own_law.py"))
    click = np.reshape(run_cells(clicks, cells, workers=workers), (len(RATES), len(STIFFNESSES)))
    print("click [N] at", *(f"{stiffness:6.0f}" for stiffness in STIFFNESSES), "N/m")
    for rate, row in zip(RATES, click):
        print(f"{rate:8.0f} Hz ", *(f"{force:6.2f}" for force in row))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(sys.argv[1])
    else:
        with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
            main(cluster.scheduler_address)
