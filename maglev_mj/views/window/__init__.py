"""Display of a scene: window, pictures, clips."""
