"""The pose sensor: its geometry, and the solver that runs in real time."""
