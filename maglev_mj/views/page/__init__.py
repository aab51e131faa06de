"""Web page of a running scene."""
