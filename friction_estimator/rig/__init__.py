"""The simulated rig: drive, plant and sensors; effects are plugged in by name."""
