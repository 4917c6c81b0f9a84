"""What the nodes have in common: messages to arrays, parameters, diagnostics. Most of it needs no
ROS."""
