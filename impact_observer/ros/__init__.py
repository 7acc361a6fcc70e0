"""ROS 2 nodes: parameters and conversion only, no mathematics."""
