"""The ROS 2 source: poses of trackers and motion capture, and labelled point clouds, over rmw_zenoh."""
