"""A device at the bench: calibration, identification, commissioning."""
