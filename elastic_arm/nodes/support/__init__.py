"""What the nodes have in common: messages to arrays, pacing, parameters, diagnostics. Most of it needs no ROS."""
