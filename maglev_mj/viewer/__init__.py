"""What a person sees: the scene with its forces and plots, in a window or as a file."""
