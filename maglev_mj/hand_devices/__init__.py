"""A gamepad or a 3D mouse as the hand: it moves the pose to which the hand's spring pulls, on six axes."""
