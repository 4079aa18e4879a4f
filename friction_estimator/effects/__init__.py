"""What a rig can hide: one class an effect, with its simulation, its regressor and its words."""
