"""Stored outputs of the commands; see README.md here."""
