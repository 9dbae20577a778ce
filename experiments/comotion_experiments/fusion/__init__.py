"""What fusing sources gains: cameras and a robot's own joints on the workcell, with truth."""
