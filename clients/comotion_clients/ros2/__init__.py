"""Updates of a scene as ROS 2 messages, without ROS: over Zenoh as rmw_zenoh sends them, or in a bag."""
