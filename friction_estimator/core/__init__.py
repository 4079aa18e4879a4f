"""The maths: arrays in, arrays out. No ROS, no files, no clock, no printing."""
