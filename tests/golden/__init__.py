"""Kept outputs of the commands: README.md here says how they are made and compared."""
