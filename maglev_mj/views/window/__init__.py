"""Window, pictures and clips of a scene."""
