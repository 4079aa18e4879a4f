"""The ROS shell: the node, the player, the parameters. It holds no maths."""
